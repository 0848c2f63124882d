"""What people look at: plots, recordings and reports."""
