"""Draw Allan deviations into a picture."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from bench.core.files import durable
from bench.core.records.sensor_specs import ImuSpec, TriadSpec
from bench.core.words.exceptions import ConfigError
from bench.evaluation.motion.noise_curves import SHOWN_UNITS, AllanCurve, AllanResult, format_noise_figures
from bench.io.results import check_file
from bench.simulation.sensors.processes import make_noise_terms
from bench.simulation.signals import allan

if TYPE_CHECKING:
    from matplotlib.axes import Axes

_INK, _BLUE, _ORANGE = "#222222", "#1f5fa8", "#d2691e"
_LINES = {
    "white noise": "#2b8a5b",
    "bias instability": "#b8860b",
    "rate random walk": "#a23b72",
    "quantization": "#8c6bb1",
}
"""Term -> color of its line."""
_CLASSES = {
    "consumer": "#2b8a5b",
    "industrial": "#1f5fa8",
    "tactical": "#b8860b",
    "navigation": "#a23b72",
}
"""Class of an IMU -> color of its line."""
_TITLES = {"gyro": "Gyroscopes", "accel": "Accelerometers"}


def check_picture(path: Path, *, force: bool) -> None:
    """Raise ConfigError if a path does not end in .png, .svg or .pdf, or cannot be written.

    With ``force``, a file that is there may be replaced.
    """
    if path.suffix not in (".png", ".svg", ".pdf"):
        raise ConfigError(f"{path}: must end in .png, .svg or .pdf")
    check_file(path, force=force)


def draw_allan(path: Path, measured: AllanResult) -> None:
    """Draw the Allan deviation of each triad into a PNG, SVG or PDF file, by the ending of the path."""
    from matplotlib.figure import Figure

    curves = measured.curves
    figure = Figure(figsize=(6.4 * len(curves), 5.2), dpi=130, layout="constrained")
    for axes, curve in zip(figure.subplots(1, len(curves), squeeze=False)[0], curves, strict=True):
        draw_curve(axes, curve, measured.spec, "fit" if measured.fitted else "datasheet")
    figure.suptitle(f"Allan deviation: {measured.name}", color=_INK, fontsize=13)
    with durable.open_binary(path) as file:
        figure.savefig(file, format=path.suffix[1:])


def draw_catalog(path: Path, units: Iterable[tuple[str, ImuSpec]]) -> None:
    """Draw the Allan deviation of IMUs, from their datasheets, into a PNG, SVG or PDF file.

    ``units`` are pairs of class and datasheet; IMUs of other classes than navigation, tactical, industrial
    and consumer are not drawn.
    """
    from matplotlib.figure import Figure

    tau = np.geomspace(0.01, 10_000.0, 61)
    figure = Figure(figsize=(12.8, 6.4), dpi=130, layout="constrained")
    plots = dict(zip(SHOWN_UNITS, figure.subplots(1, 2), strict=True))
    for grade, spec in units:
        for triad, axes in plots.items() if grade in _CLASSES else ():
            noise: TriadSpec = getattr(spec, triad)
            terms = make_noise_terms(noise)
            if not terms:
                continue
            whole = allan.expected_deviation(allan.add_processes(*terms.values()), tau)
            shown, color = SHOWN_UNITS[triad][1] * whole, _CLASSES[grade]
            style = "-" if noise.bias_instability or noise.rate_random_walk else ":"
            axes.plot(tau, shown, style, color=color, lw=1.1)
            axes.annotate(f" {spec.name}", (tau[-1], shown[-1]), fontsize=5.5, va="center", color=color)
    for triad, axes in plots.items():
        for grade, color in _CLASSES.items():
            axes.plot([], [], color=color, label=grade)
        axes.plot([], [], ":", color=_INK, label="datasheet without slow noise")
        axes.set_xlim(0.007, 40_000.0)
        _dress(axes, triad)
    title = "Allan deviation of the IMUs of the catalog, from their datasheets"
    figure.suptitle(title, color=_INK, fontsize=13)
    with durable.open_binary(path) as file:
        figure.savefig(file, format=path.suffix[1:])


def draw_curve(axes: Axes, curve: AllanCurve, spec: ImuSpec | None, name: str = "datasheet") -> None:
    """Draw a measured Allan deviation beside the curve of the datasheet, or of the fit: ``name``."""
    factor = SHOWN_UNITS[curve.triad][1]
    tau, measured, low, high = curve.tau, factor * curve.measured, factor * curve.low, factor * curve.high
    floor = 0.3 * measured.min()
    color = _BLUE if curve.terms else _ORANGE
    axes.fill_between(tau, low, high, color=color, alpha=0.2, lw=0, label="99.9 % band")
    if curve.terms:
        axes.plot(tau, factor * curve.expected, color=_BLUE, lw=1.6, label=f"{name}, all terms")
    texts = format_noise_figures(curve.triad, getattr(spec, curve.triad)) if spec else {}
    for one, term in curve.terms.items():
        shown = np.where(factor * term > floor, factor * term, np.nan)
        label = f"{one}, {texts[one]}" + ("" if np.isfinite(shown).any() else ", below the picture")
        axes.plot(tau, shown, color=_LINES[one], lw=1.2, ls="--", label=label)
    axes.plot(tau, measured, "o", ms=4.5, color=_ORANGE, mec="white", mew=0.6, label="measured, three axes")
    axes.set(ylim=(floor, 2.0 * max(measured.max(), high.max())))
    _dress(axes, curve.triad)


def _dress(axes: Axes, triad: str) -> None:
    """Give a plot of Allan deviations its axes, grid and legend."""
    axes.set(xscale="log", yscale="log", xlabel="averaging time [s]")
    axes.set(ylabel=f"Allan deviation [{SHOWN_UNITS[triad][0]}]")
    for axis in (axes.xaxis, axes.yaxis):
        axis.set_major_formatter("{x:g}")
    axes.set_title(_TITLES[triad], loc="left", color=_INK)
    axes.grid(which="major", color="#d8d8d8", lw=0.7)
    axes.grid(which="minor", color="#efefef", lw=0.5)
    axes.set_axisbelow(True)
    axes.spines[["top", "right"]].set_visible(False)
    axes.legend(frameon=False, fontsize=8.5)
