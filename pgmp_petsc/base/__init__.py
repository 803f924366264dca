"""What every room may use: errors, the surroundings of a process, progress, times and memory, ideas from outside.

Errors carry the exit status that a command ends with, and what a user is to read. Nothing here knows of mechanics, of
MPI or of files of results. Begin with `errors`, then `progress`.
"""

import os

__version__ = "0.1.0"
#: Where colorama is installed numba colours its messages by it, and standard output ends with escape codes, JSON too.
PLAIN_NUMBA = "NUMBA_DISABLE_ERROR_MESSAGE_HIGHLIGHTING"

os.environ.setdefault(PLAIN_NUMBA, "1")
