"""Files that `bench new` writes: examples, aircraft and logs."""
