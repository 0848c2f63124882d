"""Ratios with their intervals, one below the other on a logarithmic axis."""

from __future__ import annotations

import math
from collections.abc import Sequence
from html import escape
from typing import NamedTuple

from bench.core.words.wording import format_number

_WIDTH, _ROW, _LEFT, _FOOT = 520, 18, 160, 24  # [pixels]
_EDGE = 12  # between the area and the right edge [pixels]
_MARKS = (0.01, 0.02, 0.05, 0.1, 0.2, 0.5, 1.0, 2.0, 5.0, 10.0, 20.0, 50.0, 100.0, 1e3, 1e4)
_WIDEST = (1e-3, 1e5)  # ratios beyond are drawn at these


class RatioRow(NamedTuple):
    """A ratio with its interval; an end of None is open."""

    name: str
    value: float | None  # None: there is none, and the row is empty
    low: float | None
    high: float | None
    kind: str = ""  # class of its verdict


def draw_ratios(title: str, rows: Sequence[RatioRow]) -> str:
    """Return an SVG element with a dot and a bar for each row, and a line where the ratio is 1.

    Examples
    --------
    >>> draw_ratios("error over that of a", [RatioRow("s-turns", 2.0, 1.5, 2.5)]).count("<circle")
    1
    """
    ends = [end for row in rows for end in (row.value, row.low, row.high) if end is not None and end > 0.0]
    lowest, highest = (
        math.log10(min(max(end, _WIDEST[0]), _WIDEST[1])) for end in (min([0.8, *ends]), max([1.25, *ends]))
    )
    margin = 0.05 * (highest - lowest)
    lowest, highest = lowest - margin, highest + margin
    height = _ROW * len(rows) + _FOOT

    def place(ratio: float) -> float:
        part = (math.log10(min(max(ratio, _WIDEST[0]), _WIDEST[1])) - lowest) / (highest - lowest)
        return _LEFT + part * (_WIDTH - _LEFT - _EDGE)

    body = [
        f'<path class="rule" d="M{place(mark):.1f} 0V{height - _FOOT}"/>'
        f'<text x="{place(mark):.1f}" y="{height - 8}" text-anchor="middle">{mark:g}</text>'
        for mark in _MARKS
        if lowest <= math.log10(mark) <= highest
    ]
    body.append(f'<path class="unit" d="M{place(1.0):.1f} 0V{height - _FOOT}"/>')
    told = []
    for k, row in enumerate(rows):
        y = _ROW * k + 0.5 * _ROW
        body.append(f'<text x="{_LEFT - 8}" y="{y + 4:.0f}" text-anchor="end">{escape(row.name)}</text>')
        if row.value is None or row.value <= 0.0:
            continue
        low = place(row.low) if row.low is not None and row.low > 0.0 else float(_LEFT)
        high = place(row.high) if row.high is not None else float(_WIDTH - _EDGE)
        body.append(
            f'<g class="ratio {row.kind}"><path d="M{low:.1f} {y:.1f}H{high:.1f}"/>'
            f'<circle cx="{place(row.value):.1f}" cy="{y:.1f}" r="4"/></g>'
        )
        told.append(f"{row.name} {format_number(row.value, 3)}")
    words = escape(f"{title}: {', '.join(told)}")
    return (
        f'<svg class="plot" viewBox="0 0 {_WIDTH} {height}" role="img" aria-label="{words}">'
        f"{''.join(body)}</svg>"
    )
