"""Data of a run to plot, and the definition of a tab of plots."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from math import radians

import numpy as np

from bench.core.files import disk_arrays
from bench.core.mathematics.arrays import FloatArray
from bench.core.mathematics.units import SAME_INSTANT
from bench.core.records.data import (
    AirData,
    Controls,
    Events,
    NavSolution,
    Trajectory,
    no_air,
    no_controls,
    no_events,
)
from bench.core.records.findings.series import Plot, Rows, shorten
from bench.core.records.run_records import ErrorSeries, OffPath, Sensed
from bench.core.records.run_result import RunResult
from bench.core.words.exceptions import NothingToShowError
from bench.core.words.palette import Color, DrawnLook, choose_looks
from bench.evaluation.errors.total_system import locate_path


@dataclass(frozen=True, slots=True)
class Carrier:
    """The motion of the vehicle in the 3D view if there is no truth."""

    t: FloatArray  # (N,) [s]
    lla: FloatArray  # (N, 3)
    vel_n: FloatArray  # (N, 3) [m/s], n
    q_nb: FloatArray  # (N, 4)
    air: AirData
    controls: Controls
    events: Events


Motion = Trajectory | Carrier

FAR = 20.0
"""A filter whose error is so many times that of others does not set their scale."""


def carrier(solutions: Mapping[str, NavSolution], *, in_space: bool = True) -> Carrier:
    """Return the finite rows of the motion of the first solution that has any.

    If not ``in_space``, a position is enough, or an attitude if no filter has a position.

    Raises
    ------
    NothingToShowError
        If there is none.
    """
    needed: list[tuple[str, ...]] = [("lla", "vel_n", "q_nb")] if in_space else [("lla",), ("q_nb",)]
    for names, one in itertools.product(needed, solutions.values()):
        parts = [getattr(one, name) for name in names]
        good = np.flatnonzero(np.all([np.isfinite(part).all(axis=1) for part in parts], axis=0))
        if len(good):
            t, lla, vel_n, q_nb = (
                disk_arrays.take(column, good) for column in (one.t, one.lla, one.vel_n, one.q_nb)
            )
            return Carrier(t, lla, vel_n, q_nb, no_air(), no_controls(), no_events())
    raise NothingToShowError("no filter has position, velocity and attitude at any time")


@dataclass(frozen=True, slots=True)
class Content:
    """Data of a run to plot."""

    motion: Motion
    sensed: Sensed
    solutions: Mapping[str, NavSolution]
    errors: Mapping[str, ErrorSeries]
    begin: float  # of what counts; earlier values do not scale a plot [s]
    path: OffPath | None = None  # of a flight that an estimate flew
    antenna_mask: float | None = None  # elevation against b below which the antenna receives nothing [rad]

    @property
    def desired(self) -> list[FloatArray]:
        """The segments (K, 3) of the desired path: latitude, longitude, height."""
        path, motion = self.path, self.motion
        if path is None:
            return []
        rows = np.searchsorted(motion.t, path.t - SAME_INSTANT).clip(max=len(motion.t) - 1)
        lla = locate_path(path, disk_arrays.take(motion.lla, rows))
        return [part for part in split_at_gaps(lla) if len(part) > 1]

    @property
    def looks(self) -> dict[str, DrawnLook]:
        """Return the color and dash of each filter."""
        return choose_looks(self.solutions)

    @property
    def colors(self) -> dict[str, Color]:
        """The color of each estimator."""
        return {label: look.color for label, look in self.looks.items()}


def gather_content(result: RunResult, *, in_space: bool = True) -> Content | None:
    """Return the data of a result to plot; None if neither truth nor solutions have a motion.

    If not ``in_space``, a position or an attitude is enough.
    """
    if result.sensed is None:
        return None
    try:
        motion = result.truth if result.truth is not None else carrier(result.solutions, in_space=in_space)
    except NothingToShowError:
        return None
    mask = result.more.get("scene", {}).get("antenna_mask_deg")
    return Content(
        motion=motion,
        sensed=result.sensed,
        solutions=result.solutions,
        errors=result.errors,
        begin=result.evaluation.begin,
        path=result.records.get("path"),
        antenna_mask=None if mask is None else radians(mask),
    )


def split_at_gaps(rows: FloatArray) -> list[FloatArray]:
    """Return the segments of rows (M, k) without NaN."""
    known = np.isfinite(rows).all(axis=1)
    edges = np.flatnonzero(np.diff(known)) + 1
    return [part for part in np.split(rows, edges) if len(part) and np.isfinite(part[0]).all()]


@dataclass(frozen=True, slots=True)
class Tab:
    """A tab of the recording and a section of the report: a constant in a module of `plots.tabs`."""

    name: str
    place: int  # tabs stand in the order of it
    all_plots: Callable[[Content], Mapping[str, Rows]]  # by the label of the filter; "": of none

    def plots(self, content: Content) -> Mapping[str, Rows]:
        """Return the plots by label of the filter, thinned to the screen for a long flight."""
        shown = {
            label: [[replace(plot, series=tuple(map(shorten, plot.series))) for plot in row] for row in rows]
            for label, rows in self.all_plots(content).items()
        }
        disk_arrays.release()
        return share_scales(shown)


def share_scales(by_label: Mapping[str, Rows]) -> Mapping[str, Rows]:
    """Return the plots of filters with one vertical scale for each quantity.

    One that reaches `FAR` times farther than the best keeps a scale of its own: it would flatten the others.
    """
    alike: dict[tuple[str, ...], list[Plot]] = {}
    for rows in by_label.values():
        for plot in itertools.chain.from_iterable(rows):
            if plot.path[0] == "estimators":
                alike.setdefault(plot.path[2:], []).append(plot)
    shared: dict[tuple[str, ...], tuple[float, float]] = {}
    for plots in alike.values():
        limits = {plot.path: plot.limits() for plot in plots}
        least = min(max(map(abs, both)) for both in limits.values())
        near = {path: both for path, both in limits.items() if max(map(abs, both)) <= FAR * least}
        if len(near) > 1:
            both = min(low for low, _ in near.values()), max(high for _, high in near.values())
            shared |= dict.fromkeys(near, both)
    return {
        label: [[replace(plot, shared=shared.get(plot.path)) for plot in row] for row in rows]
        for label, rows in by_label.items()
    }
