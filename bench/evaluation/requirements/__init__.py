"""Requirements on a navigation filter, and whether they are met."""
