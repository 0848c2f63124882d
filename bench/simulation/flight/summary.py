"""Summary of a flight in numbers."""

from __future__ import annotations

from typing import Any

import numpy as np

from bench.core.mathematics.arrays import FloatArray
from bench.core.mathematics.earth import difference_n
from bench.core.mathematics.rotation import to_euler
from bench.core.mathematics.units import STANDARD_GRAVITY
from bench.core.records.data import Trajectory
from bench.core.records.flight_specs import TerrainSpec
from bench.simulation.signals.terrain import ground_at


def summarize(truth: Trajectory) -> dict[str, Any]:
    """Return the extremes of a flight; see `Summary`."""
    summary = Summary()
    summary.add(truth)
    return summary.result()


class Summary:
    """The extremes of a flight and its legs, collected from the pieces of its truth.

    All of the IMU, the airspeed of the aircraft; heights above ground are over a file of heights. The load
    factor is the specific force along -z of the body over standard gravity; rates are body rates relative
    to i, the largest of either sign; both are means over one sample.
    """

    def __init__(self, terrain: TerrainSpec | None = None) -> None:
        self._terrain = terrain
        self._samples, self._distance = 0, 0.0
        self._least: dict[str, float] = {}
        self._most: dict[str, float] = {}
        self._legs: list[tuple[float, float, str]] = []
        self._sanity: list[tuple[float, float, str]] = []
        self._exceedances: list[tuple[float, float, str]] = []
        self._table: list[tuple[float, float, str]] = []

    def add(self, piece: Trajectory) -> None:
        """Add the next piece, which begins at the time at which the last piece ended."""
        over_ground = np.hypot(*difference_n(piece.lla[1:], piece.lla[:-1])[:, :2].T)
        self._distance += float(over_ground.sum())
        self._samples += len(over_ground) + (not self._samples)
        dt = np.diff(piece.t)
        roll, pitch, _ = to_euler(piece.q_nb)
        w_b = np.abs(piece.dtheta_b / dt[:, None])
        self._take("t", piece.t)
        lat, lon, alt = piece.lla.T
        self._take("alt", alt)
        if self._terrain is not None:
            self._take("height", alt - ground_at(self._terrain, lat, lon))
        self._take("airspeed", piece.air.airspeed_true)
        self._take("ground_speed", np.hypot(piece.vel_n[:, 0], piece.vel_n[:, 1]))
        self._take("climb", -piece.vel_n[:, 2])
        self._take("bank", np.abs(roll))
        self._take("pitch", pitch)
        self._take("load_factor", -piece.dvel_b[:, 2] / dt / STANDARD_GRAVITY)
        for axis, name in enumerate(("roll", "pitch", "yaw")):
            self._take(f"{name}_rate", w_b[:, axis])
        self._legs += piece.events.select("leg")
        self._sanity += piece.events.select("sanity")
        self._exceedances += piece.events.select("exceedance")
        self._table += piece.events.select("table")

    def _take(self, name: str, values: FloatArray) -> None:
        if len(values):
            least, most = float(values.min()), float(values.max())
            self._least[name] = min(least, self._least.get(name, least))
            self._most[name] = max(most, self._most.get(name, most))

    def result(self) -> dict[str, Any]:
        """Return the figures so far, the unit in each key; events as (start, end, text)."""
        least, most = self._least, self._most
        duration = most["t"] - least["t"]
        both = {"alt": "_m", "height": "_m", "load_factor": ""}
        both |= dict.fromkeys(("airspeed", "ground_speed", "climb"), "_mps")
        extremes = {
            f"{name}_{end}{unit}": values[name]
            for name, unit in both.items()
            for end, values in (("min", least), ("max", most))
            if name in values
        }
        return {
            "duration_s": duration,
            "samples": self._samples,
            "rate_hz": (self._samples - 1) / duration,
            "path_over_ground_m": self._distance,
            **extremes,
            "bank_max_rad": most["bank"],
            "pitch_min_rad": least["pitch"],
            "pitch_max_rad": most["pitch"],
            **{f"{axis}_rate_max_rad_s": most[f"{axis}_rate"] for axis in ("roll", "pitch", "yaw")},
            "legs": self._legs,
            "sanity": self._sanity,
            "exceedances": self._exceedances,
            "table": self._table,
        }
