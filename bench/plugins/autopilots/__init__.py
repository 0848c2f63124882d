"""Logs of PX4 and ArduPilot, their own estimate, and a log for the replay of PX4."""
