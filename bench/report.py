"""Figures: records in, pictures out. The only place that imports matplotlib."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from bench.arrays import FloatArray

if TYPE_CHECKING:
    from matplotlib.axes import Axes

_INK, _BLUE, _ORANGE = "#222222", "#1f5fa8", "#d2691e"
_LINES = {
    "white noise": "#2b8a5b",
    "bias instability": "#b8860b",
    "rate random walk": "#a23b72",
    "quantization": "#8c6bb1",
}
"""How the text of a term begins -> colour of its line."""


@dataclass(frozen=True, slots=True)
class AllanPanel:
    """What is drawn of a triad, in the unit it is drawn in."""

    title: str
    unit: str
    tau: FloatArray  # (T,) [s]
    measured: FloatArray  # (T,)
    low: FloatArray  # (T,) band of a measurement
    high: FloatArray  # (T,)
    expected: FloatArray | None  # (T,) of the datasheet
    terms: Mapping[str, FloatArray]  # of each of its terms, by the text of the legend


def allan_picture(path: Path, title: str, panels: Sequence[AllanPanel]) -> None:
    """Draw Allan deviations side by side into a PNG, SVG or PDF, by the ending of the path."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(6.4 * len(panels), 5.2), dpi=130, layout="constrained")
    for axes, panel in zip(figure.subplots(1, len(panels), squeeze=False)[0], panels, strict=True):
        _allan_panel(axes, panel)
    figure.suptitle(title, color=_INK, fontsize=13)
    figure.savefig(path)


def _allan_panel(axes: Axes, panel: AllanPanel) -> None:
    tau, measured = panel.tau, panel.measured
    floor = 0.3 * measured.min()
    colour = _ORANGE if panel.expected is None else _BLUE
    axes.fill_between(tau, panel.low, panel.high, color=colour, alpha=0.2, lw=0, label="99.9 % band")
    if panel.expected is not None:
        axes.plot(tau, panel.expected, color=_BLUE, lw=1.6, label="datasheet, all terms")
    for name, term in panel.terms.items():
        shown = np.where(term > floor, term, np.nan)
        label = name if (term > floor).any() else f"{name}, below the picture"
        axes.plot(tau, shown, color=_LINES[name.partition(",")[0]], lw=1.2, ls="--", label=label)
    axes.plot(tau, measured, "o", ms=4.5, color=_ORANGE, mec="white", mew=0.6, label="measured, three axes")
    axes.set(xscale="log", yscale="log", xlabel="averaging time [s]")
    axes.set(
        ylabel=f"Allan deviation [{panel.unit}]", ylim=(floor, 2.0 * max(measured.max(), panel.high.max()))
    )
    for axis in (axes.xaxis, axes.yaxis):
        axis.set_major_formatter("{x:g}")
    axes.set_title(panel.title, loc="left", color=_INK)
    axes.grid(which="major", color="#d8d8d8", lw=0.7)
    axes.grid(which="minor", color="#efefef", lw=0.5)
    axes.set_axisbelow(True)
    axes.spines[["top", "right"]].set_visible(False)
    axes.legend(frameon=False, fontsize=8.5)
