"""The lowest package: code that two or more packages need."""
