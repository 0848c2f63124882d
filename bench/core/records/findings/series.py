"""Parts of a plot: lines, bands and dots in their colors, and shaded intervals."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from bench.core.files import disk_arrays
from bench.core.mathematics.arrays import BoolArray, FloatArray, IntArray
from bench.core.records.data import Events
from bench.core.words.palette import FIXES, SLOTS, Color, choose_looks

TRUTH: Color = SLOTS[0].dark
FIX: Color = FIXES.dark
OUTAGE: Color = (255, 150, 0)
FAULT: Color = (225, 70, 225)
REJECTED: Color = (255, 60, 60)
BAND: Color = (150, 150, 150)
AXIS_COLORS: tuple[Color, ...] = (SLOTS[2].dark, SLOTS[4].dark, SLOTS[1].dark)  # x, y, z and n, e, d
ESTIMATORS: tuple[Color, ...] = tuple(slot.dark for slot in SLOTS[1:])

MOST_ROWS = 25.0
"""Poses and plots hold at most this many rows a second [Hz]."""

MOST_POINTS = 30_000
"""What has more rows than this is of a long flight."""

LONG_POINTS = 8_000
"""Rows that are kept of it: a few for each pixel of a screen."""

SLOW = 5.0
"""The same for what only shows how the flight went [Hz]."""

DRIFTING = 2.0
"""The same for what drifts over minutes, such as biases [Hz]."""

SILENT = 5.0
"""So many of its usual intervals without a value are a gap."""

AXES_N = ("north", "east", "down")
AXES_B = ("x", "y", "z")


@dataclass(frozen=True, slots=True)
class Series:
    """Lines (or marks) that share their times."""

    key: str  # its name within the plot
    t: FloatArray  # (N,) [s]
    values: FloatArray  # (N, k), a column per line, in the unit of the plot
    names: tuple[str, ...]  # k, for the legend
    colors: tuple[Color, ...]  # k
    widths: tuple[float, ...]  # k [points of the screen]
    marks: bool = False  # dots instead of lines
    band: tuple[int, int] | None = None  # the lines between which a covariance or an expectation lies
    most: float = np.inf  # rows a second that are enough to show it [Hz]
    labels: tuple[str, ...] = ()  # N, beside the dots; empty: none
    dashed: bool = False


@dataclass(frozen=True, slots=True)
class Plot:
    """One plot: its place among all, the title with the unit, and what it shows."""

    path: tuple[str, ...]  # such as ("estimators", "loose-15", "position", "north")
    title: str
    series: tuple[Series, ...]
    scale_from: float = -np.inf  # earlier values do not count for the vertical axis [s]
    far: float = np.inf  # nor a series that reaches so many times farther than the middle one
    across: str = "s"  # unit of the horizontal axis
    over: str = "time"  # quantity of the horizontal axis
    log: str = ""  # "x", "y" or "xy": axes with powers of ten at equal distances
    ticks: tuple[tuple[float, str], ...] = ()  # places on the horizontal axis and their names; empty: numbers
    shared: tuple[float, float] | None = None  # limits of the vertical axis that plots beside it have, too

    def limits(self) -> tuple[float, float]:
        """Return the limits of the vertical axis, a little beyond round numbers around the values.

        The viewer writes numbers at powers of ten and their multiples as far as there is room.
        """
        if self.shared is not None:
            return self.shared
        shown = [s.values[s.t >= self.scale_from] for s in self.series]
        shown = [v[np.isfinite(v)] for v in shown]
        reach = np.array([np.abs(v).max(initial=0.0) for v in shown])
        near = reach <= self.far * np.median(reach) if np.isfinite(self.far) else np.ones(len(reach), bool)
        values = np.concatenate([v for v, is_near in zip(shown, near, strict=True) if is_near])
        if "y" in self.log:
            values = values[values > 0.0]
            low, high = (np.log10([values.min(), values.max()])) if len(values) else (0.0, 1.0)
            margin = 0.04 * (high - low) or 0.3
            return float(10.0 ** (low - margin)), float(10.0 ** (high + margin))
        low, high = (float(values.min()), float(values.max())) if len(values) else (-1.0, 1.0)
        if low < 0.0 < high:
            ten = 10.0 ** np.floor(np.log10(max(-low, high)))
            low, high = -_round_up(-low, ten), _round_up(high, ten)
        else:
            step = round_number(0.3 * (high - low) or 0.1 * abs(high) or 1.0)
            low, high = step * np.floor(low / step), step * np.ceil(high / step)
            if low == high:
                low, high = low - step, high + step
        margin = 0.04 * (high - low)
        return float(low - margin), float(high + margin)


def take_logarithms(plot: Plot) -> Plot:
    """Return a plot with decimal logarithms on its logarithmic axes, without values that are not positive."""
    series = list(plot.series)
    if "x" in plot.log:
        kept = [one.t > 0.0 for one in series]
        series = [
            replace(one, t=np.log10(one.t[rows]), values=one.values[rows], labels=_select(one.labels, rows))
            for one, rows in zip(series, kept, strict=True)
        ]
    if "y" in plot.log:
        series = [
            replace(one, values=np.log10(np.where(one.values > 0.0, one.values, np.nan))) for one in series
        ]
    return replace(plot, series=tuple(series))


def _select(labels: Sequence[str], rows: BoolArray) -> tuple[str, ...]:
    return tuple(label for label, kept in zip(labels, rows, strict=True) if kept) if labels else ()


def _round_up(value: float, ten: float) -> float:
    return 10.0 * ten if value > 5.0 * ten else float(0.5 * ten * np.ceil(value / (0.5 * ten)))


Rows = Sequence[Sequence[Plot]]
"""Plots as they stand on a tab, row by row."""


def thin(t: FloatArray, most: float = MOST_ROWS) -> slice:
    """Return the rows to keep so that no more than ``most`` come in a second [Hz]."""
    if len(t) < 2 or not t[-1] > t[0]:
        return slice(None)
    rate = (len(t) - 1) / (t[-1] - t[0])
    return slice(None, None, max(1, int(np.ceil(rate / most - 1e-6))))


def limit_rate(t: FloatArray, most: float) -> float:
    """Return how many rows a second to keep [Hz]: ``most``, or less of a long flight."""
    duration = float(np.ptp(t)) if len(t) else 0.0
    return most if most * duration <= MOST_POINTS else LONG_POINTS / duration


def select_rows(series: Series) -> IntArray:
    """Return the rows of a series that a screen can show: thinned, or the extremes of parts of its time.

    A spike of one epoch of a long flight stays, and gaps stay always.
    """
    rows = np.arange(len(series.t))
    broken = ~np.isfinite(series.values).all(axis=1)
    gaps = np.flatnonzero(broken & ~np.roll(broken, 1))  # where they begin
    thinned = rows[thin(series.t, series.most)]
    if len(thinned) <= MOST_POINTS:
        return np.union1d(thinned, gaps)
    parts = LONG_POINTS // (2 * series.values.shape[1])
    edges = np.linspace(0, len(rows), parts + 1).astype(np.int64)[:-1]
    kept = [gaps]
    for line in series.values.T:
        values = np.where(np.isfinite(line), line, np.nan)
        for worst, sign in ((np.inf, 1.0), (-np.inf, -1.0)):
            column = np.where(np.isnan(values), worst, values)
            best = np.minimum.reduceat(sign * column, edges)
            found = np.flatnonzero(sign * column == np.repeat(best, np.diff(np.append(edges, len(rows)))))
            part = np.searchsorted(edges, found, "right")
            kept.append(found[np.unique(part, return_index=True)[1]])
    return np.unique(np.concatenate([[0], *kept, [len(rows) - 1]]))


def shorten(series: Series) -> Series:
    """Return a series with only the rows that a screen can show, if it is of a long flight.

    What it read of arrays on disk is released then.
    """
    if len(range(len(series.t))[thin(series.t, series.most)]) <= MOST_POINTS:
        return series
    rows = select_rows(series)
    shown = replace(series, t=series.t[rows], values=series.values[rows])
    disk_arrays.release()
    return shown


def estimator_colors(labels: Iterable[str]) -> dict[str, Color]:
    """Return the color each filter has in every view."""
    return {label: look.color for label, look in choose_looks(labels).items()}


def round_number(value: float) -> float:
    """Return the largest of 1, 2, 5 times a power of ten that is not above value.

    Examples
    --------
    >>> round_number(430.0)
    200.0
    """
    power = 10.0 ** np.floor(np.log10(value))
    return float(max(step * power for step in (1.0, 2.0, 5.0) if step * power <= value))


def paler(color: Color) -> Color:
    """Return the color of the 3 sigma lines that belong to a line of this color."""
    return tuple((c + g) // 2 for c, g in zip(color, BAND, strict=True))  # type: ignore[return-value]


def draw_line(
    key: str,
    t: FloatArray,
    values: FloatArray,
    name: str,
    color: Color,
    most: float = SLOW,
    *,
    dashed: bool = False,
) -> Series:
    """Return one line, for which so many rows a second are enough [Hz]."""
    return shorten(Series(key, t, values[:, None], (name,), (color,), (1.5,), most=most, dashed=dashed))


def draw_dots(
    key: str,
    t: FloatArray,
    values: FloatArray,
    name: str,
    color: Color,
    size: float = 1.5,
    labels: tuple[str, ...] = (),
) -> Series:
    """Return a dot for each value, with optional names (N,) beside the dots."""
    dots = Series(key, t, values[:, None], (name,), (color,), (size,), marks=True, labels=labels)
    return dots if labels else shorten(dots)


def find_gaps(t: FloatArray) -> IntArray:
    """Return the rows (K,) of times (N,) before which much more than the usual interval has passed.

    Usual in the whole record and among its neighbors: a segment of slower rows is no row of gaps. Rows of
    the same time, such as those of several satellites, have no interval.
    """
    rows = np.flatnonzero(np.diff(t) > 0.0) + 1
    steps = t[rows] - t[rows - 1]
    if len(steps) < 2:
        return np.empty(0, np.int64)
    long = np.flatnonzero(steps > SILENT * np.median(steps))
    last = len(steps) - 1
    near = last - np.abs(last - np.abs(long[:, None] + np.arange(-2, 3)))  # mirrored at both ends
    usual = np.median(steps[np.clip(near, 0, last)], axis=1)
    gaps: IntArray = rows[long[steps[long] > SILENT * usual]]
    return gaps


def break_at_gaps(t: FloatArray, values: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return times (N,) and values (N, k) with a row of NaN in each gap, so that no line crosses it.

    Examples
    --------
    >>> t, values = break_at_gaps(np.array([0.0, 1.0, 2.0, 50.0]), np.array([[5.0], [6.0], [7.0], [8.0]]))
    >>> t, values[:, 0]
    (array([ 0.,  1.,  2., 26., 50.]), array([ 5.,  6.,  7., nan,  8.]))
    """
    gaps = find_gaps(t)
    if not len(gaps):
        return t, values
    return np.insert(t, gaps, 0.5 * (t[gaps - 1] + t[gaps])), np.insert(values, gaps, np.nan, axis=0)


def draw_three_sigma(
    key: str,
    t: FloatArray,
    value: FloatArray,
    sd: FloatArray,
    name: str,
    color: Color,
    around: FloatArray | float = 0.0,
    most: float = MOST_ROWS,
) -> Series:
    """Return a value, and 3 sigma either side of zero or of other values; ``most`` rows a second [Hz]."""
    t, values = break_at_gaps(t, np.column_stack([value, around + 3.0 * sd, around - 3.0 * sd]))
    names, pale = (name, "±3σ", "±3σ"), paler(color)
    widths = (1.5, 1.0, 1.0)
    return shorten(Series(key, t, values, names, (color, pale, pale), widths, band=(1, 2), most=most))


@dataclass(frozen=True, slots=True)
class Shade:
    """Intervals that are shaded in every plot."""

    key: str  # its name within each plot
    name: str  # for the legend
    color: Color
    intervals: tuple[tuple[float, float], ...]  # (start, end) [s]


def shades(events: Events) -> tuple[Shade, ...]:
    """Return the shaded intervals: GNSS outages and scripted faults."""
    told = (("outage", "GNSS outage", OUTAGE, "gnss_outage"), ("fault", "fault", FAULT, "fault"))
    found = (
        Shade(key, name, color, tuple((start, end) for start, end, _ in events.select(kind)))
        for key, name, color, kind in told
    )
    return tuple(shade for shade in found if shade.intervals)
