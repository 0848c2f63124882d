"""Algorithms of the two sources that `bench guide equations` names."""
