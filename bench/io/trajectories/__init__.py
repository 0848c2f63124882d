"""Trajectories and tracks of others, read as truth."""
