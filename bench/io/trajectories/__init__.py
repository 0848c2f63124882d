"""Foreign trajectories and tracks, read as truth."""
