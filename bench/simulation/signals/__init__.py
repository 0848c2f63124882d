"""What the sky, the air and the noise of instruments do, known to sensors and filters alike."""
