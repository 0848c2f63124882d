"""Commands of `bench new`, which write examples, aircraft and logs."""
