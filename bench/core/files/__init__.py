"""Files, folders and processes: whole or not at all, and ended with their parent."""
