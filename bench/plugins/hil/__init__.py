"""Flights with a client: a program or an autopilot in the loop."""
