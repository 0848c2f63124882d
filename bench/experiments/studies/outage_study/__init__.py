"""Drift without GNSS, by unit and by grade."""
