"""Plots as SVG: lines, bands and dots in a frame with round numbers.

A line with more points than pixels keeps the least and the greatest value of each column: no spike
is lost. Coordinates are tenths of a pixel, in whole numbers.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from html import escape

import numpy as np

from bench.core.mathematics.arrays import FloatArray, IntArray
from bench.core.records.findings.series import FIX, Plot, Series, Shade, round_number, take_logarithms
from bench.core.words.palette import Color, find_slot
from bench.core.words.wording import replace_control

WIDTH, HEIGHT = 420, 170
"""Size of a plot with its numbers [pixels]."""
_LEFT, _RIGHT, _TOP, _BOTTOM = 52, 14, 6, 20
_GRAIN = 10.0  # steps per pixel
_STRAIGHT = 2.0  # points so near the line between their neighbors are left out [steps]
_DOT = 3  # diameter [pixels]
_END = 0.12  # of the width: numbers nearer to the end of a time axis give way to that of the end
_LETTER, _ROW = 5.0, 10.0  # width of a letter and height of a row of the names of dots [pixels]
_LEAST_HEIGHT = 0.55  # of a track over its width
_FAR = 20.0  # beyond so many widths or heights points are not told apart

Window = tuple[float, float]


@dataclass(frozen=True, slots=True)
class Frame:
    """Area of a picture: its size in pixels, and the values at its edges."""

    x: Window  # values at the left and the right edge
    y: Window  # values at the lower and the upper edge
    width: int  # [pixels]
    height: int  # [pixels]

    def place(self, x: FloatArray, y: FloatArray) -> tuple[IntArray, IntArray]:
        """Return columns and rows of points [steps]; those far away are drawn nearer."""
        across = np.clip((x - self.x[0]) / (self.x[1] - self.x[0]), -_FAR, _FAR) * self.width
        up = (y - self.y[0]) / (self.y[1] - self.y[0])
        down = np.clip(1.0 - up, -_FAR, _FAR) * self.height
        return np.rint(_GRAIN * across).astype(np.int64), np.rint(_GRAIN * down).astype(np.int64)


def draw(plot: Plot, window: Window, shades: Sequence[Shade] = ()) -> str:
    """Return a plot as an SVG element.

    Parameters
    ----------
    plot : Plot
        What to draw.
    window : (float, float)
        Where the horizontal axis begins and ends, such as the first and the last epoch [s].
    shades : sequence of Shade
        Intervals to shade behind the lines.
    """
    words = escape(replace_control(describe(plot)))
    across, up = (
        (float(np.log10(a)), float(np.log10(b))) if axis in plot.log else (a, b)
        for axis, (a, b) in zip("xy", (window, plot.limits()), strict=True)
    )
    frame = Frame(across, up, WIDTH - _LEFT - _RIGHT, HEIGHT - _TOP - _BOTTOM)
    plot = take_logarithms(plot)
    body = [_draw_shade(frame, shade) for shade in shades]
    body += [_draw_band(frame, series) for series in plot.series if series.band is not None]
    for series in plot.series:
        body += _draw_series(frame, series)
    body += _draw_labels(frame, plot)
    marks = [
        f'<text x="{_LEFT - 6}" y="{_TOP + row / _GRAIN + 4:.0f}" text-anchor="end">{text}</text>'
        for row, text in _mark_rows(frame, "y" in plot.log)
    ]
    return (
        f'<svg class="plot" viewBox="0 0 {WIDTH} {HEIGHT}" role="img" aria-label="{words}">'
        f'{"".join(marks)}<g class="times">{"".join(_mark_times(frame, plot))}</g>'
        f"{_open_area(frame, plot)}{_draw_grid(frame, 'y' in plot.log)}{''.join(body)}</svg></svg>"
    )


def describe(plot: Plot) -> str:
    """Return a plot in words: its title, and how far each line reaches from ``scale_from`` on."""
    parts = []
    for series in plot.series:
        for k, name in enumerate(series.names):
            values = series.values[series.t >= plot.scale_from, k]
            values = values[np.isfinite(values)]
            if len(values) and name not in series.names[:k]:
                parts.append(f"{name} {values.min():.3g} to {values.max():.3g}")
    return f"{plot.title}: {', '.join(parts)}" if parts else f"{plot.title}: no values"


def draw_track(
    paths: Sequence[tuple[str, Color, FloatArray]],
    dots: FloatArray,
    stretches: Sequence[tuple[str, FloatArray]] = (),
    instants: Sequence[tuple[str, FloatArray]] = (),
    circles: Sequence[tuple[str, float]] = (),
) -> str:
    """Return a track seen from above as an SVG element, north up, equal scales.

    Parameters
    ----------
    paths : sequence of (name, color, (N, 2) array)
        North and east [m], finite; the first sets the scale, without one the dots.
    dots : (M, 2) array
        North and east of fixes [m].
    stretches : sequence of (key of a shade, (K, 2) array)
        Parts of the way that are shaded [m].
    instants : sequence of (name, (2,) array)
        Places with a ring and a name [m]; a name that would lie on an earlier one is left out.
    circles : sequence of (name, radius)
        Around the origin [m].
    """
    first = paths[0][2] if paths else dots
    first = np.vstack([first, *([[-r, -r], [r, r]] for _, r in circles)])
    low, high = first.min(axis=0), first.max(axis=0)
    middle, reach = 0.5 * (low + high), 0.56 * max(float((high - low).max()), 1.0)
    width = 420
    needed = max((0.5 * float(high[0] - low[0]) + 0.12 * reach) / reach, _LEAST_HEIGHT)
    height = round(width * min(needed, 1.0))
    reaches = reach * height / width, reach
    north, east = ((float(m - r), float(m + r)) for m, r in zip(middle, reaches, strict=True))
    frame = Frame(east, north, width, height)
    body = []
    for key, path in stretches:
        if len(path):
            x, y = frame.place(path[:, 1], path[:, 0])
            body.append(f'<path class="segment {key}" d="{_join(np.column_stack([x, y]))}"/>')
    if len(dots):
        body.append(_draw_dots(frame, dots[:, 1], dots[:, 0], "fix", FIX, "GNSS"))
    for name, color, path in reversed(paths):
        x, y = frame.place(path[:, 1], path[:, 0])
        body.append(_write_path("line", _join(np.column_stack(_straighten(x, y))), color, name))
    step = round_number(reach)
    bar = step / (2.0 * reach) * width
    columns, rows = frame.place(first[:, 1], first[:, 0])
    across = columns[rows > (height - 40) * _GRAIN] / _GRAIN  # what the bar may lie on
    begin = 16.0
    if (across < begin + bar).sum() > (across > width - begin - bar).sum():
        begin = width - begin - bar
    return (
        f'<svg class="track" viewBox="0 0 {width} {height}" role="img" '
        f'aria-label="Track from above, north up, {2.0 * reach:.4g} m wide">'
        f'<svg viewBox="0 0 {width * 10} {height * 10}">{"".join(body)}</svg>'
        f'<path class="bar" d="M{begin:.1f} {height - 16}h{bar:.1f}"/>'
        f'<text x="{begin:.1f}" y="{height - 22}">{_format_length(step)}</text>'
        f'<path class="bar" d="M{width - 20} 44V16m-5 8l5 -8l5 8"/>'
        f'<text x="{width - 20}" y="58" text-anchor="middle">N</text>{"".join(_draw_circles(frame, circles))}'
        f"{''.join(_name_places(frame, instants))}"
        "</svg>"
    )


def _draw_circles(frame: Frame, circles: Sequence[tuple[str, float]]) -> Iterable[str]:
    """Yield circles around the origin with their names above them."""
    for name, radius in circles:
        columns, rows = frame.place(np.array([0.0, radius]), np.array([0.0, radius]))
        (x, right), (y, top) = (np.asarray(steps) / _GRAIN for steps in (columns, rows))
        yield f'<circle class="bar" cx="{x:.1f}" cy="{y:.1f}" r="{right - x:.1f}"/>'
        yield f'<text class="place" x="{x:.1f}" y="{top - 4:.0f}" text-anchor="middle">{escape(name)}</text>'


def _name_places(frame: Frame, instants: Sequence[tuple[str, FloatArray]]) -> Iterable[str]:
    """Yield a ring and a name for each place; first and last come first."""
    used: list[tuple[float, float, float]] = []  # begin, end, row
    for name, place in [*instants[:1], *instants[:0:-1]]:
        columns, rows = frame.place(place[1:], place[:1])
        x, y = float(columns[0]) / _GRAIN, float(rows[0]) / _GRAIN
        yield f'<circle class="place" cx="{x:.1f}" cy="{y:.1f}" r="3.5"/>'
        length = 1.2 * _LETTER * len(name)
        begin = x + 7.0 if x + 7.0 + length < frame.width else x - 7.0 - length
        if any(begin < b and begin + length > a and abs(y - row) < _ROW + 2.0 for a, b, row in used):
            continue
        used.append((begin, begin + length, y))
        yield f'<text class="place" x="{begin:.0f}" y="{y - 4:.0f}">{escape(name)}</text>'


def _format_length(meters: float) -> str:
    return f"{meters / 1e3:g} km" if meters >= 1e3 else f"{meters:g} m"


def _open_area(frame: Frame, plot: Plot) -> str:
    """Return the start of the area of the lines; the script of the page reads what its edges are worth."""
    edges = " ".join(f"{edge:.9g}" for edge in (*frame.x, *frame.y))
    named = any(one.labels for one in plot.series)
    kind = "still" if plot.ticks or named else "area"  # the script draws numbers only
    return (
        f'<svg class="{kind}" x="{_LEFT}" y="{_TOP}" width="{frame.width}" height="{frame.height}" '
        f'viewBox="0 0 {frame.width * 10} {frame.height * 10}" preserveAspectRatio="none" '
        f'data-edges="{edges}" data-unit="{escape(plot.across)}" data-log="{plot.log}">'
    )


def round_steps(low: float, high: float, most: int) -> FloatArray:
    """Return round numbers in an interval, at most so many.

    Examples
    --------
    >>> round_steps(0.0, 600.0, 7).tolist()
    [0.0, 100.0, 200.0, 300.0, 400.0, 500.0, 600.0]
    """
    step = round_number((high - low) / most)
    while np.floor(high / step) - np.ceil(low / step) + 1 > most:
        step = round_number(2.6 * step)
    return step * np.arange(np.ceil(low / step - 1e-9), np.floor(high / step + 1e-9) + 1) + 0.0  # no -0


def round_marks(low: float, high: float, most: int, *, log: bool) -> tuple[FloatArray, FloatArray]:
    """Return the positions of round numbers on an axis, and the numbers."""
    if not log:
        steps = round_steps(low, high, most)
        return steps, steps
    within = [round(k) for k in np.arange(np.ceil(low - 1e-9), np.floor(high + 1e-9) + 1)]
    numbers = np.array([10.0**k for k in within[:: -(-len(within) // most) or 1]])
    if len(within) <= 2:  # too few powers of ten
        decades = range(int(np.floor(low)), int(np.ceil(high)) + 1)
        numbers = np.array([part * 10.0**k for k in decades for part in (1.0, 2.0, 5.0)])
        numbers = numbers[(numbers >= 10.0 ** (low - 1e-9)) & (numbers <= 10.0 ** (high + 1e-9))]
        if len(numbers) < 2:  # a narrow one has round numbers as a plain axis has
            numbers = round_steps(10.0**low, 10.0**high, most)
    return np.log10(numbers), numbers


def _mark_rows(frame: Frame, log: bool) -> Iterable[tuple[float, str]]:
    steps, numbers = round_marks(*frame.y, 5, log=log)
    _, rows = frame.place(np.full(len(steps), frame.x[0]), steps)
    return [(float(row), format_mark(value)) for row, value in zip(rows, numbers, strict=True)]


def format_mark(value: float) -> str:
    """Return a number beside an axis, short enough for its room."""
    size = abs(value)
    if size >= 1e7 or 1e-12 <= size < 1e-4:
        digits, power = f"{value:.5e}".split("e")
        return f"{float(digits):g}e{int(power)}".replace("-", "−")
    text = f"{value / 1e3:.6g}k" if size >= 1e4 else f"{0.0 if size < 1e-12 else value:.6g}"
    return text.replace("-", "−")


def _mark_times(frame: Frame, plot: Plot) -> Iterable[str]:
    """Yield the numbers below a plot; an axis of time ends on one, with its unit."""
    if plot.ticks:
        columns, _ = frame.place(np.array([at for at, _ in plot.ticks]), np.full(len(plot.ticks), frame.y[0]))
        for column, (_, name) in zip(columns, plot.ticks, strict=True):
            yield _mark_time(_LEFT + column / _GRAIN, "middle", escape(name))
        return
    steps, numbers = round_marks(*frame.x, 7, log="x" in plot.log)
    if plot.across in ("s", "h") and not plot.log:
        last = frame.x[1] - _END * (frame.x[1] - frame.x[0])
        steps, numbers = steps[steps < last], numbers[numbers < last]
        yield _mark_time(WIDTH - 2, "end", f"{format_mark(float(f'{frame.x[1]:.4g}'))} {plot.across}")
    columns, _ = frame.place(steps, np.full(len(steps), frame.y[0]))
    for column, value in zip(columns, numbers, strict=True):
        yield _mark_time(_LEFT + column / _GRAIN, "middle", format_mark(value))


def _mark_time(x: float, anchor: str, text: str) -> str:
    return f'<text x="{x:.0f}" y="{HEIGHT - 5}" text-anchor="{anchor}">{text}</text>'


def _draw_grid(frame: Frame, log: bool) -> str:
    rows = "".join(f"M0 {row:.0f}h{frame.width * 10}" for row, _ in _mark_rows(frame, log))
    return f'<path class="rule" d="{rows}"/>'


def _draw_shade(frame: Frame, shade: Shade) -> str:
    parts = []
    for start, end in shade.intervals:
        x, _ = frame.place(np.array([start, max(end, start)]), np.zeros(2))
        width = max(int(x[1] - x[0]), 10)
        parts.append(f'<rect x="{x[0]}" width="{width}" height="{frame.height * 10}"/>')
    return f'<g class="{shade.key}">{"".join(parts)}</g>'


def _draw_band(frame: Frame, series: Series) -> str:
    """Return the area between the two lines of a band, in the color of the first line of the series."""
    assert series.band is not None
    one, two = (series.values[:, k] for k in series.band)
    low, high = np.minimum(one, two), np.maximum(one, two)
    good = np.isfinite(low) & np.isfinite(high)
    parts = []
    for rows in _split_runs(good):
        x, down = _outline(frame, series.t[rows], low[rows], np.minimum)
        x_up, up = _outline(frame, series.t[rows], high[rows], np.maximum)
        if len(x) == 1:
            continue
        there, back = _straighten(x_up, up), _straighten(x, down)
        parts.append(_join(np.column_stack([*there])) + "L" + _join(np.column_stack([*back])[::-1])[1:] + "z")
    return _write_path("band", "".join(parts), series.colors[0], series.names[series.band[0]])


def _outline(frame: Frame, t: FloatArray, values: FloatArray, farther: np.ufunc) -> tuple[IntArray, IntArray]:
    """Return the outer edge of a band: in each pixel column the value that is farther out."""
    x, y = frame.place(t, values)
    column = x // int(_GRAIN)
    if len(x) <= frame.width:
        return x, y
    first = np.append(0, np.flatnonzero(np.diff(column)) + 1)
    outer = np.maximum if farther is np.minimum else np.minimum  # rows count downwards
    return x[first], outer.reduceat(y, first)


def _draw_series(frame: Frame, series: Series) -> Iterable[str]:
    edges = series.band or ()
    for k, color in enumerate(series.colors):
        values = series.values[:, k]
        good = np.isfinite(values)
        if k in edges or not good.any():
            continue
        if series.marks:
            yield _draw_dots(frame, series.t[good], values[good], "dots", color, series.names[k])
        else:
            runs = [_thin(*frame.place(series.t[rows], values[rows])) for rows in _split_runs(good)]
            data = "".join(_join(np.column_stack(_straighten(*run))) for run in runs)
            yield _write_path("line dashed" if series.dashed else "line", data, color, series.names[k])


def _thin(x: IntArray, y: IntArray) -> tuple[IntArray, IntArray]:
    """Return the lowest and the highest point of each pixel column, in the order in which they came."""
    column = x // int(_GRAIN)
    first = np.append(0, np.flatnonzero(np.diff(column)) + 1)
    if len(x) <= 2 * len(first):
        return x, y
    top, bottom = np.minimum.reduceat(y, first), np.maximum.reduceat(y, first)
    falls = 2 * y[first] <= top + bottom  # begins nearer its top: rows count downwards
    pairs = np.column_stack([np.where(falls, top, bottom), np.where(falls, bottom, top)])
    return np.repeat(x[first], 2), pairs.ravel()


def _draw_labels(frame: Frame, plot: Plot) -> Iterable[str]:
    """Yield the names of dots, to their right; those that would lie on others are moved up or down."""
    places: list[tuple[int, int, str]] = []
    for series in plot.series:
        if series.labels:
            columns, rows = frame.place(series.t, series.values[:, 0])
            places += zip(columns.tolist(), rows.tolist(), series.labels, strict=True)
    line, wide, high = round(_GRAIN * _ROW), round(_GRAIN * frame.width), round(_GRAIN * frame.height)
    used: list[tuple[int, int, int]] = []  # begin, end, row
    for x, y, text in sorted(places):
        length = round(_GRAIN * _LETTER * len(text))
        begin = min(x + line // 2, wide - length)
        free = (
            row
            for row in sorted(range(line // 2, high, line // 4), key=lambda row: abs(row - y))
            if all(begin >= b or begin + length <= a or abs(row - other) >= line for a, b, other in used)
        )
        row = next(free, y)
        used.append((begin, begin + length, row))
        yield f'<text class="name" x="{begin}" y="{row + line // 3}">{escape(text)}</text>'


def _draw_dots(frame: Frame, x: FloatArray, y: FloatArray, kind: str, color: Color, name: str) -> str:
    """Return dots; dots of one pixel column that touch become one stroke."""
    good = np.isfinite(x) & np.isfinite(y)
    columns, rows = frame.place(x[good], y[good])
    grid = int(_GRAIN)
    cells = np.unique(np.column_stack([columns // grid, rows // grid]), axis=0)
    if not len(cells):
        return ""
    apart = (np.diff(cells[:, 0]) != 0) | (np.diff(cells[:, 1]) > _DOT)
    first = np.append(0, np.flatnonzero(apart) + 1)
    last = np.append(first[1:], len(cells)) - 1
    at = grid * cells + grid // 2
    marks = zip(at[first].tolist(), at[last, 1].tolist(), strict=True)
    path = "".join(f"M{a} {b}v{end - b}" for (a, b), end in marks)
    return _write_path(kind, path, color, name)


def _split_runs(good: np.ndarray) -> list[slice]:
    """Return the runs of rows that are good."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], good, [False]]).astype(np.int8)))
    return [slice(int(a), int(b)) for a, b in edges.reshape(-1, 2)]


def _straighten(x: IntArray, y: IntArray) -> tuple[IntArray, IntArray]:
    """Leave out points that lie on the line between their neighbors."""
    for _ in range(8):
        if len(x) < 3:
            break
        before, here, after = slice(0, -2, 2), slice(1, -1, 2), slice(2, None, 2)
        count = len(x[here])
        dx, dy = (v[after][:count] - v[before][:count] for v in (x, y))
        off = dx * (y[here] - y[before][:count]) - dy * (x[here] - x[before][:count])
        keep = np.ones(len(x), bool)
        keep[here] = np.abs(off) > _STRAIGHT * np.maximum(np.hypot(dx, dy), 1.0)
        if keep.all():
            break
        x, y = x[keep], y[keep]
    return x, y


def _join(points: IntArray) -> str:
    """Return the path data of a line: the first point, then steps."""
    first, steps = points[0], np.diff(points, axis=0)
    return f"M{first[0]} {first[1]}" + (
        f"l{' '.join(map(str, steps.ravel().tolist()))}" if len(steps) else "h1"
    )


def _write_path(kind: str, data: str, color: Color, name: str) -> str:
    """Return a path; the script of the page finds what belongs to a name of the legend by ``data-name``."""
    words = escape(replace_control(name))
    return f'<path class="{kind}" d="{data}" style="--c:{css_color(color)}" data-name="{words}"/>'


def css_color(color: Color) -> str:
    """Return a color in CSS syntax; a color of the palette as its variable."""
    slot = find_slot(color)
    if slot is not None:
        return f"var(--s{slot})"
    red, green, blue = color
    return f"color-mix(in srgb, #{red:02x}{green:02x}{blue:02x} var(--deep), var(--into))"
