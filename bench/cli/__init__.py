"""The command line, what its verbs print, and the public functions of Python."""
