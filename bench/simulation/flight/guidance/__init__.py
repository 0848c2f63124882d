"""The path that is wanted, and how the aircraft is kept on it."""
