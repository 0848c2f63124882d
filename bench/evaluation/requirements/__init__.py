"""Requirements on a navigator, and their check."""
