"""Find the noises that a filter should assume."""
