"""Recordings of real sensors, read as records."""
