"""Models of sky, air and noise that sensors and filters share."""
