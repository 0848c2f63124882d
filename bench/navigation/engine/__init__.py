"""Time and trust: what of a record comes when, what may be trusted, and how it is kept between pieces."""
