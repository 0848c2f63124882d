"""Time and trust: what of a record comes when, what may be believed, and how it is kept between pieces."""
