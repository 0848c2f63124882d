"""Which IMU is enough, and what limits it."""
