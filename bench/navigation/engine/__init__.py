"""Time and trust: what of a record comes when, what may be assumed, and how it is kept between pieces."""
