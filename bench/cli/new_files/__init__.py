"""What `bench new` writes: examples, aircraft and logs."""
