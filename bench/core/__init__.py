"""The ground floor: what two rooms or more need."""
