"""The command ``pgmp``: thin commands over the studies, and the frame that they run in."""
