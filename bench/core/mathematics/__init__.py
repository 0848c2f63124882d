"""Arrays, units, rotations, the Earth and random numbers."""
