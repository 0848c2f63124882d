"""Logs of PX4, ArduPilot and MAVLink, their own estimate, and a log for the replay of PX4."""
