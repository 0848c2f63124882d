"""Fixes from the files of a receiver: position from the code, velocity from the Doppler."""

from __future__ import annotations

import csv
from collections.abc import Sequence
from dataclasses import dataclass, replace
from datetime import datetime, timedelta
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from bench.core.files import durable
from bench.core.mathematics import earth
from bench.core.mathematics.arrays import FloatArray, IntArray
from bench.core.records.data import GnssFixes, GnssObservations
from bench.core.records.findings import FindingTable, make_table
from bench.core.records.orbit_sets import GLONASS, SYSTEM_NAMES, name_satellite
from bench.core.records.run_records import SkyView
from bench.core.words.exceptions import ConfigError
from bench.evaluation.consistency.nees_band import find_band
from bench.plugins.receiver import implausible_fixes, lost_epochs, unfit_systems
from bench.plugins.receiver.fix_truth import Truth
from bench.plugins.receiver.ionosphere_choice import choose_ionosphere
from bench.plugins.receiver.receiver_streams.android_log import read_android
from bench.plugins.receiver.receiver_streams.rtcm import read_rtcm
from bench.plugins.receiver.receiver_streams.sbf import read_sbf
from bench.plugins.receiver.receiver_streams.ubx import read_ubx
from bench.plugins.receiver.rinex.ephemerides import NavigationFile
from bench.plugins.receiver.rinex.lines import find_kind
from bench.plugins.receiver.rinex.observations import ObservationFile, read_observations
from bench.plugins.receiver.rinex.one_receiver import merge_observations
from bench.plugins.receiver.rinex.precise_orbits import read_orbits
from bench.simulation.signals import dilution, orbits, receiver_solution, smoothing
from bench.simulation.signals.processing import Processing, estimate_code_sd

_EPOCH = datetime(1980, 1, 6)
_HEADER = (
    "gps_time,valid,lat_deg,lon_deg,alt_m,vel_n_mps,vel_e_mps,vel_d_mps,sd_n_m,sd_e_m,sd_d_m,"
    "satellites,hdop,vdop"
)
_MOVING_SPEED = 0.5  # median speed above which a receiver moves; at rest it is a few cm/s; assumed [m/s]
_MOVING_SPREAD = 50.0  # 95 % distance from the median position above which it moves; assumed [m]
_MOST_LINES = 6  # of parts that are left out; a file of another kind has hundreds


class SatelliteUse(NamedTuple):
    """A satellite over all epochs with a fix."""

    name: str
    epochs: int  # where it was used
    excluded: int  # epochs where it was left out
    residual_rms: float  # [m]
    residual_max: float  # [m]
    cn0: float  # mean [dB-Hz]


_HEADS = {
    "satellite": "satellite", "epochs": "used", "excluded": "left out", "residual_rms_m": "residual RMS [m]",
    "residual_max_m": "largest [m]", "cn0_dbhz": "C/N0 [dB-Hz]",
}  # fmt: skip
"""Column of the table of satellites -> its words on a page."""


def tabulate_satellites(found: Sequence[SatelliteUse], title: str) -> FindingTable:
    """Return the table of how satellites were used."""
    return replace(make_table("satellites", title, list(_HEADS), found), heads=_HEADS)


@dataclass(frozen=True, slots=True)
class RinexFixes:
    """An observation file, its fixes, the dilution of precision of the satellites used, and remarks.

    ``notes`` are lines for a person: what is left out of the files, why there is no fix, and why the fixes
    are not compared with the position in the header.
    """

    observations: ObservationFile
    seen: GnssObservations
    solution: receiver_solution.ReceiverSolution
    dop: dilution.Dop
    reasons: tuple[str, ...]  # of epochs without a fix
    reason: IntArray  # (M,) which of them an epoch has; -1: it has a fix
    truth: Truth | None = None
    notes: tuple[str, ...] = ()
    truth_sd: float = 0.0  # of what the fixes are compared with: one constant error along each axis [m]

    @property
    def fixes(self) -> GnssFixes:
        """The fixes of the antenna, one row per epoch; NaN and not valid if there is no fix."""
        return self.solution.fixes

    @property
    def name(self) -> str:
        """The marker name in the observation file, else the name of the file."""
        names = [Path(one).name for one in self.observations.shown.split(", ")]
        return self.observations.marker or ", ".join(names)

    @property
    def day(self) -> str:
        """The date of the first epoch, ISO 8601, GPS time."""
        return _format_time(self.observations.origin + self.observations.t[0])[:10]

    @property
    def hours(self) -> str:
        """The first and the last epoch, GPS time."""
        first, last = (_format_time(self.observations.origin + self.observations.t[k]) for k in (0, -1))
        return f"{first} to {last.removeprefix(first[:11])} GPS time"

    @property
    def moving(self) -> bool:
        """Return whether the receiver moves, by an event in the file, its speed, or its fix spread."""
        good = self.fixes.valid
        if self.observations.moving or not good.any():
            return self.observations.moving
        speed = np.linalg.norm(self.fixes.vel_n[good], axis=1)
        if np.isfinite(speed).any():
            return bool(np.nanmedian(speed) > _MOVING_SPEED)
        pos_e = earth.to_ecef(self.fixes.lla[good])
        far = np.linalg.norm(pos_e - np.median(pos_e, axis=0), axis=1)
        return bool(np.percentile(far, 95) > _MOVING_SPREAD)

    @property
    def compared(self) -> bool:
        """Return whether the antenna position is known: by a truth, or by the header if at rest."""
        approximate = self.observations.approximate_e
        known = approximate is not None and bool(approximate.any())
        return self.truth is not None or (known and not self.moving)

    def errors(self) -> FloatArray:
        """Return fix minus antenna (M, 3) [m], n: the truth, else header position plus antenna offset.

        Raises
        ------
        ValueError
            If there is no truth, and the header gives no position.
        """
        raw = self.observations
        if self.truth is not None:
            return earth.difference_n(self.fixes.lla, self.truth.at(raw.origin, raw.t))
        if raw.approximate_e is None:
            raise ValueError(f"{raw.shown}: gives no position in its header")
        height, east, north = raw.antenna_hen
        there = earth.displace(earth.to_geodetic(raw.approximate_e), [north, east, -height])
        return earth.difference_n(self.fixes.lla, there)

    def figures(self) -> dict[str, Any]:
        """Return counts, medians and 95 % quantiles; names end in the unit.

        Errors are relative to the truth, or to the position in the header of the file; there are none if the
        receiver moves and no truth is given. NEES counts ``truth_sd`` beside the covariance of a fix.
        """
        raw, fixes, good = self.observations, self.fixes, self.fixes.valid
        figures: dict[str, Any] = {"epochs": len(fixes), "fixes": int(good.sum())}
        if raw.lost:
            figures["epochs_left_out"] = raw.lost
        if raw.recounted:
            figures["epochs_with_a_wrong_count"] = raw.recounted
        if not good.any():
            return figures
        figures["satellites_median"] = float(np.median(fixes.satellites[good]))
        figures["hdop_median"] = float(np.median(self.dop.h[good]))
        figures["vdop_median"] = float(np.median(self.dop.v[good]))
        excluded = self.solution.wanted & ~self.solution.used & np.isin(self.seen.epoch, np.flatnonzero(good))
        figures["epochs_with_exclusions"] = len(np.unique(self.seen.epoch[excluded]))
        if self.compared:
            figures |= self._judge()
        speed = np.linalg.norm(fixes.vel_n[good], axis=1)
        if np.isfinite(speed).any():
            figures["speed_median_mps"] = float(np.nanmedian(speed))
        for k, name in enumerate(SYSTEM_NAMES[1:], 1):
            offset = (self.solution.clock[:, k] - self.solution.clock[:, 0])[good]
            if np.isfinite(offset).any():
                figures[f"{name.lower()}_minus_gps_clock_m"] = float(np.nanmedian(offset))
        return figures

    def _judge(self) -> dict[str, float]:
        good = self.fixes.valid.copy()
        error = self.errors()
        good &= np.isfinite(error).all(axis=1)
        if not good.any():
            return {}
        error, cov = error[good], self.fixes.cov_pos_n[good] + self.truth_sd**2 * np.eye(3)
        horizontal, vertical = np.hypot(error[:, 0], error[:, 1]), np.abs(error[:, 2])
        figures = {}
        for name, values in (
            ("horizontal", horizontal), ("vertical", vertical), ("3d", np.hypot(horizontal, vertical))
        ):  # fmt: skip
            figures[f"{name}_median_m"] = float(np.median(values))
            figures[f"{name}_95_m"] = float(np.percentile(values, 95))
        figures["nees_3"] = float(np.mean(_square(error, cov)) / 3)
        figures["nees_horizontal_2"] = float(np.mean(_square(error[:, :2], cov[:, :2, :2])) / 2)
        return figures

    def judge(self) -> tuple[str, str]:
        """Return the verdict on the reported covariances, a word and a sentence; empty without a truth."""
        figures = self.figures()
        if "nees_3" not in figures:
            return "", ""
        ratio = figures["nees_3"]
        low, high = self._find_band()
        word, says = (
            ("overconfident", "are larger than") if ratio > 1 else ("underconfident", "are smaller than")
        )
        if low <= ratio <= high:
            word, says = "consistent", "fit"
        beside = f" with {self.truth_sd:g} m for the reference" if self.truth_sd else ""
        return word, (
            f"the errors {says} what the covariances report{beside}: NEES/3 is {ratio:.2f} "
            f"(1 is right; of records as long as this 95 % have {low:.2g} to {high:.2g}, "
            "as errors stay for hours)"
        )

    def _find_band(self) -> tuple[float, float]:
        """Return between which NEES/3 fits: the error of the reference is one for all epochs."""
        good, variance = self.fixes.valid, self.truth_sd**2
        weights = np.linalg.inv(self.fixes.cov_pos_n[good] + variance * np.eye(3))
        share = variance * float(np.einsum("mii->m", weights).mean()) / 3
        return find_band(self.observations.t[good], share)

    def count_lost(self) -> dict[str, int]:
        """Return how many epochs have no fix for each reason."""
        return {reason: int((self.reason == k).sum()) for k, reason in enumerate(self.reasons)}

    def view_sky(self, t: FloatArray) -> SkyView:
        """Return the satellites above the horizon, at epochs with a position, at times t (M,) [s]."""
        los_n = self.solution.los_n
        rows = np.flatnonzero(np.isfinite(los_n[:, 2]) & (los_n[:, 2] < 0.0))
        n, e, d = los_n[rows].T
        return SkyView(
            t=t[self.seen.epoch[rows]],
            system=self.seen.system[rows],
            sat=self.seen.sat[rows],
            azimuth=np.arctan2(e, n),
            elevation=np.arcsin(-d),
            cn0=self.seen.cn0[rows, 0],
            used=self.solution.used[rows],
        )

    def list_satellites(self) -> list[SatelliteUse]:
        """Return how each satellite was used at epochs with a fix."""
        seen, solution = self.seen, self.solution
        good = self.fixes.valid[seen.epoch] & (solution.used | solution.wanted)
        names, which = np.unique(1000 * seen.system[good] + seen.sat[good], return_inverse=True)
        used = solution.used[good]
        residual = np.where(used, np.abs(solution.residual[good]), 0.0)
        cn0 = seen.cn0[good, 0]
        heard = np.isfinite(cn0)
        n = np.bincount(which, used)
        left = np.bincount(which, ~used)
        rms = np.sqrt(np.bincount(which, residual**2) / np.where(n > 0, n, np.nan))
        most = np.zeros(len(names))
        np.maximum.at(most, which, residual)
        count = np.bincount(which, heard)
        strength = np.bincount(which, np.where(heard, cn0, 0.0)) / np.where(count > 0, count, np.nan)
        return [
            SatelliteUse(
                name_satellite(*divmod(int(name), 1000)),
                int(n[k]),
                int(left[k]),
                rms[k],
                most[k],
                strength[k],
            )
            for k, name in enumerate(names)
        ]

    def write_csv(self, path: Path, datum: str = "WGS-84") -> None:
        """Write one row per epoch as CSV; times in GPS time, positions in one of
        `bench.core.mathematics.earth.DATUMS`.

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


def _square(error: FloatArray, cov: FloatArray) -> FloatArray:
    """Return the squared errors (M,) over their covariances (M, n, n)."""
    return np.asarray(np.einsum("mi,mi->m", error, np.linalg.solve(cov, error[..., None])[..., 0]))


def solve_files(
    observations: Sequence[Path],
    navigation: Sequence[Path],
    processing: Processing,
    *,
    truth: Truth | None = None,
    window: float = 0.0,
    loops: receiver_solution.Loops | None = None,
) -> RinexFixes:
    """Solve observation files of one receiver epoch by epoch with the ephemerides of navigation files.

    ``window`` is that of smoothing [s], ``loops`` as `receiver_solution.make_observations` takes it.

    Raises
    ------
    ConfigError
        If a file is wrong, or no ephemeris fits the observations.
    """
    nav = read_orbits(navigation)
    raw = merge_observations([_read(path, window > 0, nav) for path in observations])
    processing, notes = choose_ionosphere(raw, nav, processing)
    pseudorange, noise = raw.pseudorange, None
    if raw.sd is not None:
        usual = estimate_code_sd(raw.system, raw.cn0[:, 0], processing.budget)
        noise = np.fmax(raw.sd[:, 0] / usual, 1.0)
    if window > 0:
        pseudorange, noise = _smooth(raw, nav, window)
        if not np.isfinite(raw.phase).any():
            raise ConfigError(f"{raw.shown}: has no carrier phase to smooth its ranges with")
    seen = receiver_solution.make_observations(
        noise=noise,
        loops=loops,
        t=raw.t,
        epoch_start=raw.epoch_start,
        sat=raw.sat,
        system=raw.system,
        band=raw.band,
        pseudorange=pseudorange,
        doppler=raw.doppler,
        cn0=raw.cn0,
        sets={k: [one.shift_origin(raw.origin) for one in sets] for k, sets in nav.list_orbits().items()},
        klobuchar=nav.klobuchar,
        processing=processing,
    )
    unserved = lost_epochs.describe_unserved(raw, nav, processing)
    if not np.isfinite(seen.sat_clock).any():
        times = np.concatenate([one.t for sets in nav.list_orbits().values() for one in sets])
        text = (
            f"{nav.shown}: its ephemerides, {lost_epochs.format_span(times)}, "
            f"fit no satellite of {raw.shown}, {lost_epochs.format_span(raw.origin + raw.t)}"
        )
        raise ConfigError("; ".join([text, *unserved, *nav.reasons[:_MOST_LINES]]))
    solution = receiver_solution.solve_fixes(seen, processing)
    if unfit := unfit_systems.find_unfit(seen, solution, processing):
        seen, processing = unfit_systems.leave_out(seen, processing, unfit)
        solution = receiver_solution.solve_fixes(seen, processing)
        notes += [one.describe(len(raw.t)) for one in unfit]
    dop = dilution.compute_dop(seen.epoch_start, solution.los_n, seen.system, solution.used)
    reasons, reason = lost_epochs.explain(seen, solution, processing)
    solution, reasons, reason = lost_epochs.reject_implausible(solution, reasons, reason)
    solved = RinexFixes(raw, seen, solution, dop, tuple(reasons), reason, truth)
    notes += [*_describe_lost(raw, "epoch"), *_describe_lost(nav, "ephemeris"), *nav.notes, *unserved]
    notes += lost_epochs.describe_lacking(raw, nav, processing, seen.sat_clock)
    if raw.recounted:
        notes.append(f"{raw.recounted} epochs have another number of satellites than announced: kept")
    if raw.others:
        notes.append(f"not used: {', '.join(raw.others)}")
    notes += _describe_unsolved(solved)
    fixes = solved.fixes.valid
    if fixes.any() and not (implausible_fixes.count_spare(solution)[fixes] > 0).any():
        notes.append("no fix has a satellite to spare: nothing tests them, and one wrong range moves them")
    if truth is not None and (covered := int(np.isfinite(solved.errors()[fixes, 0]).sum())) < fixes.sum():
        notes.append(f"the truth covers {covered} of {fixes.sum()} fixes: the others are not evaluated")
    return replace(solved, notes=tuple(notes))


def _read(path: Path, phase: bool, nav: NavigationFile) -> ObservationFile:
    kind = find_kind(path, str(path))
    if read := {"ubx": read_ubx, "sbf": read_sbf, "gnsslogger": read_android}.get(kind):
        return read(path, str(path))
    if kind == "rtcm":
        times = np.concatenate([one.t for sets in nav.list_orbits().values() for one in sets])
        return read_rtcm(path, str(path), float(np.median(times)) if len(times) else None)
    return read_observations(path, str(path), phase=phase)


def _smooth(raw: ObservationFile, nav: NavigationFile, window: float) -> tuple[FloatArray, FloatArray]:
    """Return smoothed ranges (K, 2), and the noise (K,) of the first carrier's relative to the code noise."""
    t = np.repeat(raw.t, np.diff(raw.epoch_start))
    channels = np.zeros(256, np.int64)
    channels[nav.glonass.sat] = nav.glonass.channel
    channel = np.where(raw.system == GLONASS, channels[raw.sat.clip(0, 255)], 0)
    ranges, noise = raw.pseudorange.copy(), np.ones(len(t))
    for k in range(2):
        found = smoothing.smooth_ranges(
            t, 1000 * raw.system + raw.sat, raw.pseudorange[:, k], raw.phase[:, k], raw.doppler[:, k],
            raw.slipped[:, k], orbits.find_frequency(raw.system, raw.band[:, k], channel), window,
        )  # fmt: skip
        ranges[:, k] = found.pseudorange
        noise = found.noise if k == 0 else noise
    return ranges, noise


def _describe_lost(file: ObservationFile | NavigationFile, part: str) -> list[str]:
    """Return a line for each of the first parts left out of a file, and a line that counts the rest."""
    lines = [f"{part} left out: {reason}" for reason in file.reasons[:_MOST_LINES]]
    each = len(file.reasons) >= min(file.lost, _MOST_LINES)  # else the lines have counts in them
    more = file.lost - len(lines) if each else 0
    return [*lines, f"{part} left out: {more} more"] if more else lines


def _describe_unsolved(solved: RinexFixes) -> list[str]:
    """Return a line for each reason why epochs have no fix."""
    if not solved.fixes.valid.any():
        worst = max(solved.count_lost().items(), key=lambda item: item[1], default=("it has no epoch", 0))
        return [f"no fix: {worst[0]}"]
    raw, lines = solved.observations, []
    for k, (reason, count) in enumerate(solved.count_lost().items()):
        first = _format_time(raw.origin + raw.t[np.argmax(solved.reason == k)])
        lines.append(f"no fix at {count} of {len(raw.t)} epochs, the first at {first}: {reason}")
    return lines


def _format_time(seconds: float) -> str:
    return (_EPOCH + timedelta(seconds=seconds)).isoformat(sep=" ", timespec="seconds")
