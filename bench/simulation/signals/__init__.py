"""Models of the sky, the air and the noise of sensors, shared by sensors and filters."""
