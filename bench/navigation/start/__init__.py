"""Start of a filter: alignment, several headings, restart after a gap."""
