"""What is required of a navigator, and whether it is kept."""
