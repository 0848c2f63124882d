"""GNSS as ranges and range rates of every satellite in view."""
