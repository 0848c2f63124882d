"""Start of a filter without a known state: alignment, several headings, restart after a gap."""
