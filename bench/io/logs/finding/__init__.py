"""Sensors in texts and folders of tables."""
