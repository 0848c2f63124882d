"""Campaigns: one command, many runs. Plan, engine, journal and tables."""
