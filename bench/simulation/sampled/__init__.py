"""A flight and its IMU sample by sample: a command between two samples acts on the second."""
