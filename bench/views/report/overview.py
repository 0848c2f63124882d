"""The two pictures at the head of a report: errors beside their covariances, and the track."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from bench.core.files import disk_arrays
from bench.core.mathematics import earth
from bench.core.mathematics.arrays import FloatArray
from bench.core.records.data import Trajectory
from bench.core.records.findings import series
from bench.core.records.findings.series import Plot, Series, Shade
from bench.views.plots.content import Content
from bench.views.report import svg

_LEAST = 1e-3  # smaller errors are drawn as this, the axis is logarithmic [m]
_EVERY = 20  # row of the truth on the track
_FEW = 2000  # rows of which every one is drawn
_TIMES = 5  # epochs that are written on the track, at most
_DESIRED = "desired path"
_LINES = 3  # filters whose covariances are drawn: more would hide each other


def plot_errors(content: Content) -> Plot | None:
    """Return the horizontal error of each filter, and its covariance, 1 sigma, dashed; None if none has one.

    Claims are left out where a dash tells two filters apart, or where there are too many.
    """
    lines = tuple(_list_lines(content))
    return (
        Plot(("overview",), "horizontal position error [m]", lines, content.begin, log="y") if lines else None
    )


def _list_lines(content: Content) -> Iterator[Series]:
    looks = content.looks
    claimed = len(looks) <= _LINES and not any(look.dashed for look in looks.values())
    for label, errors in content.errors.items():
        look, cov = looks[label], content.solutions[label].cov
        size = np.maximum(np.hypot(errors.pos_n[:, 0], errors.pos_n[:, 1]), _LEAST)
        if not np.isfinite(size).any():
            continue
        yield series.draw_line(label, errors.t, size, label, look.color, dashed=look.dashed)
        sd = np.sqrt(cov[:, 0, 0] + cov[:, 1, 1])
        if claimed and np.isfinite(sd).any():
            name = f"{label} reported sigma"
            yield series.draw_line(
                name, content.solutions[label].t, np.maximum(sd, _LEAST), name, look.color, dashed=True
            )


def draw_track(content: Content, shades: Sequence[Shade]) -> str:
    """Return the track from above: paths, fixes, start and end, epochs, and where something is shaded."""
    motion = content.motion
    origin = motion.lla[0]
    if not np.isfinite(origin).all():
        return ""
    rows = slice(None, None, _EVERY if len(motion.t) > _FEW else 1)
    ground = earth.local_ned(disk_arrays.take(motion.lla, rows), origin)[:, :2]
    t = np.asarray(disk_arrays.take(motion.t, rows))
    paths = [("truth", series.TRUTH, ground)] if isinstance(motion, Trajectory) else []
    for label, solution in content.solutions.items():
        good = np.isfinite(solution.lla).all(axis=1)
        if good.any():
            paths.append((label, content.colors[label], earth.local_ned(solution.lla[good], origin)[:, :2]))
    paths += [(_DESIRED, series.BAND, earth.local_ned(stretch, origin)[:, :2]) for stretch in content.desired]
    if not paths:
        return ""
    dots = np.empty((0, 2))
    if (fixes := content.sensed.data.fixes) is not None:
        good = fixes.valid & np.isfinite(fixes.lla).all(axis=1)
        dots = earth.local_ned(fixes.lla[good], origin)[:, :2]
    stretches = [
        (shade.key, ground[(t >= start) & (t <= end)]) for shade in shades for start, end in shade.intervals
    ]
    return svg.draw_track(paths, dots, stretches, name_instants(t, ground))


def name_instants(t: FloatArray, ground: FloatArray) -> list[tuple[str, FloatArray]]:
    """Return start, end and round epochs between them, each with its place (2,)."""
    first, last = float(t[0]), float(t[-1])
    if first == last:
        return [("start", ground[0])]
    steps = svg.round_steps(first, last, _TIMES + 2)
    inner = steps[(steps > first + 0.08 * (last - first)) & (steps < last - 0.08 * (last - first))]
    places = np.column_stack([np.interp(inner, t, axis) for axis in ground.T])
    between = [(f"{at:g} s", place) for at, place in zip(inner.tolist(), places, strict=True)]
    return [("start", ground[0]), *between, (f"end, {last:.0f} s", ground[-1])]


def list_track_legend(content: Content) -> list[tuple[str, str, str]]:
    """Return name, color and kind of what the track shows."""
    known = isinstance(content.motion, Trajectory)
    legend = [("truth", svg.css_color(series.TRUTH), "line")] if known else []
    legend += [(label, svg.css_color(color), "line") for label, color in content.colors.items()]
    legend += [(_DESIRED, svg.css_color(series.BAND), "line")] if content.desired else []
    return legend + ([("GNSS", svg.css_color(series.FIX), "dots")] if content.sensed.data.fixes else [])
