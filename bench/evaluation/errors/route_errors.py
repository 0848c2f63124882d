"""Cross-track error on a leg due to the heading alignment, and its inverse (B-8), on the sphere."""

from __future__ import annotations

import math

RADIUS = 6_371_000.0  # mean radius of the Earth [m]


def cross_track_error(length: float, heading_error: float) -> float:
    """Return the cross-track error [m] at the end of a leg of a length [m] with a heading error [rad].

    Examples
    --------
    >>> round(cross_track_error(1e6, math.radians(0.1)), 1)
    1738.2
    """
    return RADIUS * math.asin(math.sin(length / RADIUS) * math.sin(heading_error))


def allowed_heading_error(length: float, cross_track: float) -> float:
    """Return the heading error [rad] that causes a cross-track error [m] at the end of a leg of a length [m].

    Raises
    ------
    ValueError
        If the leg is not shorter than a quarter of the Earth, or the error is larger than any heading makes.
    """
    if not 0.0 < length < 0.5 * math.pi * RADIUS:
        raise ValueError(f"a leg of {length:g} m: it must be shorter than {0.5 * math.pi * RADIUS:g} m")
    ratio = math.sin(cross_track / RADIUS) / math.sin(length / RADIUS)
    if not abs(ratio) <= 1.0:
        raise ValueError(f"{cross_track:g} m across track on {length:g} m; it must be shorter than the leg")
    return math.asin(ratio)
