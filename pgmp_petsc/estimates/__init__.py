"""How far a reduced run may be trusted: its estimated error, and how far it left the small deformations it assumes."""
