"""Steps while the state is not known: alignment, several headings, restart after a gap."""
