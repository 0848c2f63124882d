"""Filters: they receive SensorData and InitialState, and never the truth."""
