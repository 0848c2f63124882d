"""Fixes from RINEX files: position from the code, velocity from the Doppler."""

from __future__ import annotations

import csv
from collections.abc import Sequence
from dataclasses import dataclass, replace
from datetime import datetime, timedelta
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from bench import durable, earth
from bench.arrays import BoolArray, FloatArray
from bench.data import GLONASS, GPS, GnssFixes, GnssObservations
from bench.errors import ConfigError
from bench.exchange.rinex.ephemerides import NavigationFile, merge_navigation, read_navigation
from bench.exchange.rinex.observations import ObservationFile, read_observations
from bench.signals import dilution, receiver
from bench.signals.orbits import DAY

_EPOCH = datetime(1980, 1, 6)
_HEADER = (
    "gps_time,valid,lat_deg,lon_deg,alt_m,vel_n_mps,vel_e_mps,vel_d_mps,sd_n_m,sd_e_m,sd_d_m,"
    "satellites,hdop,vdop"
)


_MOVING_SPEED = 0.5  # median speed above which a receiver moves; at rest it is a few cm/s; assumed [m/s]
_MOVING_SPREAD = 50.0  # 95 % distance from the median position above which it moves; assumed [m]


@dataclass(frozen=True, slots=True)
class RinexFixes:
    """An observation file, its fixes, the dilution of precision of the satellites used, and remarks.

    ``notes`` are lines for a person: what is left out of the files, why there is no fix, and why the fixes
    are not compared with the position in the header.
    """

    observations: ObservationFile
    solution: receiver.ReceiverSolution
    dop: dilution.Dop
    notes: tuple[str, ...] = ()

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

    @property
    def moving(self) -> bool:
        """Whether the receiver moves: by an event in the file, its speed, or the spread of its fixes."""
        good = self.fixes.valid
        if self.observations.moving or not good.any():
            return self.observations.moving
        speed = np.linalg.norm(self.fixes.vel_n[good], axis=1)
        if np.isfinite(speed).any():
            return bool(np.nanmedian(speed) > _MOVING_SPEED)
        pos_e = earth.to_ecef(self.fixes.lla[good])
        far = np.linalg.norm(pos_e - np.median(pos_e, axis=0), axis=1)
        return bool(np.percentile(far, 95) > _MOVING_SPREAD)

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

        Errors are relative to the position in the header of the file; there are none if the receiver moves.
        """
        raw, fixes, good = self.observations, self.fixes, self.fixes.valid
        figures: dict[str, Any] = {"epochs": len(fixes), "fixes": int(good.sum())}
        if raw.lost:
            figures["epochs_left_out"] = raw.lost
        if not good.any():
            return figures
        figures["satellites_median"] = float(np.median(fixes.satellites[good]))
        figures["hdop_median"] = float(np.median(self.dop.h[good]))
        figures["vdop_median"] = float(np.median(self.dop.v[good]))
        if raw.approximate_e is not None and raw.approximate_e.any() and not self.moving:
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
        with durable.open_text(path, newline="") as file:
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
    dop = dilution.compute_dop(seen.epoch_start, solution.los_n, seen.system, solution.used)
    solved = RinexFixes(raw, solution, dop)
    notes = [*_describe_lost(raw, "epoch"), *_describe_lost(nav, "ephemeris")]
    if not solved.fixes.valid.any():
        notes.append(f"no fix: {_explain_no_fix(seen, processing)}")
    elif solved.moving and raw.approximate_e is not None:
        notes.append("the receiver moves: its fixes are not compared with the position in the header")
    return replace(solved, notes=tuple(notes))


def _describe_lost(file: ObservationFile | NavigationFile, part: str) -> list[str]:
    """Return a line for each part of a file that is left out, and one that counts those not listed."""
    more = file.lost - len(file.reasons)
    lines = [f"{part} left out: {reason}" for reason in file.reasons]
    return [*lines, f"{part} left out: {more} more"] if more else lines


def _explain_no_fix(seen: GnssObservations, processing: receiver.Processing) -> str:
    """Return why no epoch has a fix: the first condition that leaves too few satellites."""

    def count_most(rows: ArrayLike) -> int:
        total = np.concatenate([[0], np.cumsum(rows)])
        return int((total[seen.epoch_start[1:]] - total[seen.epoch_start[:-1]]).max())

    rows = np.isfinite(seen.pseudorange).any(axis=1)
    chosen = rows & np.isfinite(seen.sat_clock)
    wanted: BoolArray = np.full(len(seen), True)
    if processing.systems in ("gps", "glonass"):
        wanted = seen.system == (GPS if processing.systems == "gps" else GLONASS)
    ranges = receiver.correct_pseudoranges(seen, processing)
    free = processing.ionosphere == "free"
    carriers = "two carriers (--ionosphere klobuchar needs one)" if free else "the first carrier"
    needed = 3 + len(np.unique(seen.system[rows & wanted])) if (rows & wanted).any() else 4
    for kept, condition in (
        (rows, "a pseudorange"),
        (rows & wanted, f"a pseudorange of --systems {processing.systems}"),
        (chosen & wanted, "a healthy ephemeris of the hour"),
        (chosen & wanted & np.isfinite(ranges), f"a pseudorange on {carriers}"),
    ):
        if (most := count_most(kept)) < needed:
            return f"no epoch has {needed} satellites with {condition}; the most are {most}"
    low = receiver.solve_fixes(seen, replace(processing, mask=-np.pi / 2))
    most = count_most(low.used & (-low.los_n[:, 2] > np.sin(processing.mask)))
    if low.fixes.valid.any() and most < needed:
        mask = f"{np.rad2deg(processing.mask):g} deg"
        return f"no epoch has {needed} satellites above the mask, {mask}; the most are {most}"
    return "the measurements of no epoch agree with one position"


def _format_days(nav: NavigationFile) -> str:
    t = np.concatenate([nav.kepler.t, nav.glonass.t])
    return f"{_format_day(float(t.min()))} to {_format_day(float(t.max()))}"


def _format_day(seconds: float) -> str:
    return str((_EPOCH + timedelta(days=seconds // DAY)).date())
