"""Find the axes and the unit of a receiver's velocities from its own positions.

Over spans of a second or more the mean velocity is compared with the change of the position, for every order
and sign of the axes and every usual unit. Another choice than the given one counts if the likelihood rises by
far.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from bench.core.mathematics.arrays import FloatArray
from bench.core.mathematics.rotation import list_signed_axes, write_axes

UNITS = {"m/s": 1.0, "km/h": 3.6, "knots": 1.944, "ft/s": 3.281}
"""Name of a unit -> its number in one m/s."""
_NAMES = ("north", "east", "down")
_EVIDENCE = 15.0  # by which the logarithm of the likelihood must rise
_OVERLAP = 2.0  # differences that share their time with a neighbor count this much less
_FLOOR = 0.02  # of the residuals [m/s]: no receiver is better
_FAR = 0.25  # relative difference from positions within which velocities follow them
_SHARE = 0.002  # of the power, from which an axis is compared
_SEEN = 0.5  # correlation from which the vertical axis is compared


class VelocityFrame(NamedTuple):
    """Matrix (3, 3) from velocities of a file to north, east, down in m/s, and what is wrong with them."""

    matrix: FloatArray
    text: str  # empty: nothing


def find_frame(by_position: FloatArray, by_velocity: FloatArray) -> VelocityFrame:
    """Return the axes and the unit with which velocities (M, 3) fit the changes of position (M, 3)."""
    given = np.eye(3)
    count = len(by_position) / _OVERLAP

    def weigh(matrix: FloatArray) -> float:
        off = by_position - by_velocity @ matrix.T
        return 0.5 * count * float(np.log(np.var(off, axis=0) + _FLOOR**2).sum())

    def scale(axes: FloatArray, unit: str) -> FloatArray:
        return axes / UNITS[unit]

    signed = list_signed_axes()
    plain = weigh(given)
    best = min(((weigh(scale(axes, unit)), k, unit) for k, axes in enumerate(signed) for unit in UNITS))
    cost, k, unit = best
    axes = signed[k]
    # an axis along which nothing moves is as given
    for axis in range(3):
        flipped = axes * np.where(np.arange(3) == axis, -1.0, 1.0)[:, None]
        if flipped[axis, axis] > 0 and weigh(scale(flipped, unit)) < cost + _EVIDENCE:
            axes, cost = flipped, weigh(scale(flipped, unit))
    seen = _correlate(by_position, by_velocity @ axes.T) > _SEEN
    if axes[2, 2] < 0.0 and not seen[2]:
        axes = axes * np.array([1.0, 1.0, -1.0])[:, None]
        cost = weigh(scale(axes, unit))
    if plain - cost < _EVIDENCE or not _follows(by_position, by_velocity @ scale(axes, unit).T):
        return VelocityFrame(given, "")
    return VelocityFrame(scale(axes, unit), _describe(axes, unit))


def _follows(by_position: FloatArray, by_velocity: FloatArray) -> bool:
    """Return whether positions and velocities move by equal amounts, north and east; as far as seen, down.

    A heave or a gait that is sampled shows in positions and velocities by chance.
    """
    power = np.square(by_velocity).sum(axis=0)
    gain = (by_position * by_velocity).sum(axis=0) / np.maximum(power, 1e-12)
    seen = _correlate(by_position, by_velocity) > _SEEN
    moves = (power > _SHARE * power.sum()) & (seen | [True, True, False])
    return bool((np.abs(gain - 1.0)[moves] < _FAR).all())


def _correlate(a: FloatArray, b: FloatArray) -> FloatArray:
    """Return the correlation (3,) of rows (M, 3), axis by axis, around 0."""
    power = np.square(a).sum(axis=0) * np.square(b).sum(axis=0)
    return np.asarray((a * b).sum(axis=0) / np.sqrt(np.maximum(power, 1e-300)))


def _describe(axes: FloatArray, unit: str) -> str:
    words = []
    if not np.array_equal(axes, np.eye(3)):
        words.append(f"north, east, down are {write_axes(axes, _NAMES)} of the file")
    if unit != "m/s":
        words.append(f"the unit is {unit}")
    return f"gnss: its velocity fits its positions if {' and '.join(words)}" if words else ""
