"""The desired path, and the guidance that keeps the aircraft on the path."""
