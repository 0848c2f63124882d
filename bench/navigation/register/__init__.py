"""Algorithms of the sources that stand for themselves; nothing of the other rooms imports from here."""
