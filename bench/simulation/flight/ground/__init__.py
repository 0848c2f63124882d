"""What wheels roll on, and the landing gear of a model."""
