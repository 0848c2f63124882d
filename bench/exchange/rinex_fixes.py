"""Fixes from RINEX files: position from the code, velocity from the Doppler."""

from __future__ import annotations

import csv
from collections.abc import Sequence
from dataclasses import dataclass
from datetime import datetime, timedelta
from pathlib import Path
from typing import Any

import numpy as np

from bench import earth
from bench.arrays import FloatArray
from bench.data import GnssFixes
from bench.errors import ConfigError
from bench.exchange.rinex.ephemerides import NavigationFile, merge_navigation, read_navigation
from bench.exchange.rinex.observations import ObservationFile, read_observations
from bench.signals import least_squares, receiver
from bench.signals.orbits import DAY

_EPOCH = datetime(1980, 1, 6)
_HEADER = (
    "gps_time,valid,lat_deg,lon_deg,alt_m,vel_n_mps,vel_e_mps,vel_d_mps,sd_n_m,sd_e_m,sd_d_m,"
    "satellites,hdop,vdop"
)


@dataclass(frozen=True, slots=True)
class RinexFixes:
    """An observation file, its fixes, and the dilution of precision of the satellites used."""

    observations: ObservationFile
    solution: receiver.ReceiverSolution
    dop: least_squares.Dop

    @property
    def fixes(self) -> GnssFixes:
        """The fixes of the antenna, one row per epoch; NaN and not valid if there is no fix."""
        return self.solution.fixes

    @property
    def name(self) -> str:
        """The marker name in the observation file, else the name of the file."""
        return self.observations.marker or self.observations.shown

    @property
    def day(self) -> str:
        """The date of the first epoch, ISO 8601, GPS time."""
        return _format_day(self.observations.origin + self.observations.t[0])

    def errors(self) -> FloatArray:
        """Return fix minus antenna position (header position plus antenna offset) (M, 3) [m], n.

        Raises
        ------
        ValueError
            If the header gives no position.
        """
        raw = self.observations
        if raw.approximate_e is None:
            raise ValueError(f"{raw.shown}: gives no position in its header")
        height, east, north = raw.antenna_hen
        there = earth.displace(earth.to_geodetic(raw.approximate_e), [north, east, -height])
        return earth.difference_n(self.fixes.lla, there)

    def figures(self) -> dict[str, Any]:
        """Return counts, medians and 95 % quantiles; names end in the unit.

        Errors are relative to the position in the header of the file.
        """
        raw, fixes, good = self.observations, self.fixes, self.fixes.valid
        figures: dict[str, Any] = {"epochs": len(fixes), "fixes": int(good.sum())}
        if not good.any():
            return figures
        figures["satellites_median"] = float(np.median(fixes.satellites[good]))
        figures["hdop_median"] = float(np.median(self.dop.h[good]))
        figures["vdop_median"] = float(np.median(self.dop.v[good]))
        if raw.approximate_e is not None and raw.approximate_e.any():
            error = self.errors()[good]
            horizontal, vertical = np.hypot(error[:, 0], error[:, 1]), np.abs(error[:, 2])
            for name, values in (("horizontal", horizontal), ("vertical", vertical)):
                figures[f"{name}_median_m"] = float(np.median(values))
                figures[f"{name}_95_m"] = float(np.percentile(values, 95))
        speed = np.linalg.norm(fixes.vel_n[good], axis=1)
        if np.isfinite(speed).any():
            figures["speed_median_mps"] = float(np.nanmedian(speed))
        both = np.isfinite(self.solution.clock).all(axis=1) & good
        if both.any():
            offset = self.solution.clock[both, 1] - self.solution.clock[both, 0]
            figures["glonass_minus_gps_clock_m"] = float(np.median(offset))
        return figures

    def write_csv(self, path: Path, datum: str = "WGS-84") -> None:
        """Write one row per epoch as CSV; times in GPS time, positions in one of `bench.earth.DATUMS`.

        Raises
        ------
        OSError
            If the file cannot be written.
        """
        raw, fixes, dop = self.observations, self.fixes, self.dop
        lla = earth.to_datum(fixes.lla, datum)
        sd = np.sqrt(np.einsum("mii->mi", fixes.cov_pos_n))
        with path.open("w", newline="", encoding="utf-8") as file:
            rows = csv.writer(file)
            rows.writerow(_HEADER.split(","))
            for m in range(len(fixes)):
                time = (
                    _EPOCH + timedelta(seconds=raw.origin) + timedelta(seconds=float(raw.t[m]))
                ).isoformat()
                place = [f"{np.rad2deg(lla[m, 0]):.9f}", f"{np.rad2deg(lla[m, 1]):.9f}", f"{lla[m, 2]:.3f}"]
                speed = [f"{v:.4f}" for v in fixes.vel_n[m]]
                spread = [f"{s:.3f}" for s in sd[m]]
                dilution = [f"{dop.h[m]:.2f}", f"{dop.v[m]:.2f}"]
                rows.writerow(
                    [time, int(fixes.valid[m]), *place, *speed, *spread, fixes.satellites[m], *dilution]
                )


def solve_rinex(
    observations: Path, navigation: Sequence[Path], processing: receiver.Processing
) -> RinexFixes:
    """Solve an observation file epoch by epoch with the ephemerides of navigation files.

    Raises
    ------
    ConfigError
        If a file is wrong, or no ephemeris fits the observations.
    """
    raw = read_observations(observations, str(observations))
    nav = merge_navigation([read_navigation(path, str(path)) for path in navigation])
    model = nav.klobuchar
    if model is None and processing.ionosphere == "klobuchar" and "ionosphere" not in processing.without:
        raise ConfigError(
            f"{nav.shown}: gives no ionosphere parameters; use --ionosphere free or --without ionosphere"
        )
    seen = receiver.make_observations(
        t=raw.t,
        epoch_start=raw.epoch_start,
        sat=raw.sat,
        system=raw.system,
        pseudorange=raw.pseudorange,
        doppler=raw.doppler,
        cn0=raw.cn0,
        kepler=nav.kepler.shift_origin(raw.origin),
        glonass=nav.glonass.shift_origin(raw.origin),
        klobuchar=model,
        processing=processing,
    )
    if not np.isfinite(seen.sat_clock).any():
        raise ConfigError(
            f"{nav.shown}: its ephemerides, {_format_days(nav)}, fit no satellite of {raw.shown}, "
            f"{_format_day(raw.origin + raw.t[0])} to {_format_day(raw.origin + raw.t[-1])}"
        )
    solution = receiver.solve_fixes(seen, processing)
    dop = least_squares.compute_dop(seen.epoch_start, solution.los_n, seen.system, solution.used)
    return RinexFixes(raw, solution, dop)


def _format_days(nav: NavigationFile) -> str:
    t = np.concatenate([nav.kepler.t, nav.glonass.t])
    return f"{_format_day(float(t.min()))} to {_format_day(float(t.max()))}"


def _format_day(seconds: float) -> str:
    return str((_EPOCH + timedelta(days=seconds // DAY)).date())
