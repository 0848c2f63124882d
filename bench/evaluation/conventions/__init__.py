"""Wrong conventions that a solution may be given in."""
