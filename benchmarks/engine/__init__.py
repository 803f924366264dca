"""The engine of reduced models beside bare C."""
