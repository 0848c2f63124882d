"""``bench navigate``: fixes from the observations of a real receiver."""

from __future__ import annotations

import csv
from collections.abc import Sequence
from datetime import datetime, timedelta
from pathlib import Path
from typing import Any

import numpy as np
from rich.console import Console
from rich.table import Table

from bench import earth
from bench.arrays import FloatArray
from bench.errors import ConfigError
from bench.exchange.rinex import NavigationFile, ObservationFile, merged, read_navigation, read_observations
from bench.signals import least_squares, receiver
from bench.signals.orbits import DAY

_EPOCH = datetime(1980, 1, 6)


def solve_files(
    observations: Path, navigation: Sequence[Path], processing: receiver.Processing
) -> tuple[ObservationFile, receiver.Solution, least_squares.Dop]:
    """Return an observation file, its fixes, and the dilution of precision of the satellites used.

    Raises
    ------
    ConfigError
        When a file is wrong, or the ephemerides do not serve the observations.
    """
    raw = read_observations(observations, str(observations))
    nav = merged([read_navigation(path, str(path)) for path in navigation])
    model = nav.klobuchar
    if model is None and processing.ionosphere == "klobuchar" and "ionosphere" not in processing.without:
        raise ConfigError(
            f"{nav.shown}: gives no ionosphere parameters; use --ionosphere free or --without ionosphere"
        )
    seen = receiver.observe(
        t=raw.t,
        epoch_start=raw.epoch_start,
        sat=raw.sat,
        system=raw.system,
        pseudorange=raw.pseudorange,
        doppler=raw.doppler,
        cn0=raw.cn0,
        kepler=nav.kepler.since(raw.origin),
        glonass=nav.glonass.since(raw.origin),
        klobuchar=model,
        processing=processing,
    )
    if not np.isfinite(seen.sat_clock).any():
        raise ConfigError(
            f"{nav.shown}: its ephemerides, {_days(nav)}, serve no satellite of {raw.shown}, "
            f"{_day(raw.origin + raw.t[0])} to {_day(raw.origin + raw.t[-1])}"
        )
    solution = receiver.solve(seen, processing)
    dop = least_squares.dop(seen.epoch_start, solution.los_n, seen.system, solution.used)
    return raw, solution, dop


def navigate(
    console: Console,
    observations: Path,
    navigation: Sequence[Path],
    processing: receiver.Processing,
    datum: str,
    out: Path | None,
) -> dict[str, Any]:
    """Solve an observation file, print what came out, write the fixes, and return the figures.

    Parameters
    ----------
    console : Console
        Where to print.
    observations, navigation : Path, sequence of Path
        RINEX files.
    processing : Processing
        How to solve.
    datum : str
        Of the positions in ``out``.
    out : Path or None
        CSV file to write.

    Raises
    ------
    ConfigError
        When a file is wrong.
    """
    raw, solution, dop = solve_files(observations, navigation, processing)
    figures = summary(raw, solution, dop)
    table = Table("", "")
    for name, value in figures.items():
        table.add_row(name, f"{value:.3f}" if isinstance(value, float) else str(value))
    console.print(f"{raw.marker or raw.shown}: {_day(raw.origin + raw.t[0])}, {len(raw.t)} epochs")
    console.print(table)
    if out is not None:
        _write(out, raw, solution, dop, datum)
        console.print(f"fixes in {datum}: {out}")
    return figures


def summary(raw: ObservationFile, solution: receiver.Solution, dop: least_squares.Dop) -> dict[str, Any]:
    """Return the figures of a solution; errors are against the position in the header."""
    fixes, good = solution.fixes, solution.fixes.valid
    figures: dict[str, Any] = {"epochs": len(fixes), "fixes": int(good.sum())}
    if not good.any():
        return figures
    figures["satellites_median"] = float(np.median(fixes.satellites[good]))
    figures["hdop_median"] = float(np.median(dop.h[good]))
    figures["vdop_median"] = float(np.median(dop.v[good]))
    if raw.approximate_e is not None and raw.approximate_e.any():
        error = errors(raw, solution)[good]
        horizontal, vertical = np.hypot(error[:, 0], error[:, 1]), np.abs(error[:, 2])
        for name, values in (("horizontal", horizontal), ("vertical", vertical)):
            figures[f"{name}_median_m"] = float(np.median(values))
            figures[f"{name}_95_m"] = float(np.percentile(values, 95))
    speed = np.linalg.norm(fixes.vel_n[good], axis=1)
    if np.isfinite(speed).any():
        figures["speed_median_mps"] = float(np.nanmedian(speed))
    both = np.isfinite(solution.clock).all(axis=1) & good
    if both.any():
        offset = solution.clock[both, 1] - solution.clock[both, 0]
        figures["glonass_minus_gps_clock_m"] = float(np.median(offset))
    return figures


def errors(raw: ObservationFile, solution: receiver.Solution) -> FloatArray:
    """Return fix minus header position plus antenna offset (M, 3) [m], n."""
    if raw.approximate_e is None:
        raise ValueError(f"{raw.shown}: gives no position in its header")
    height, east, north = raw.antenna_hen
    there = earth.displace(earth.to_geodetic(raw.approximate_e), [north, east, -height])
    return earth.difference_n(solution.fixes.lla, there)


def _write(
    out: Path, raw: ObservationFile, solution: receiver.Solution, dop: least_squares.Dop, datum: str
) -> None:
    fixes = solution.fixes
    lla = earth.to_datum(fixes.lla, datum)
    with out.open("w", newline="", encoding="utf-8") as file:
        rows = csv.writer(file)
        rows.writerow(
            [
                "gps_time",
                "valid",
                "lat_deg",
                "lon_deg",
                "alt_m",
                "vel_n_mps",
                "vel_e_mps",
                "vel_d_mps",
                "sd_n_m",
                "sd_e_m",
                "sd_d_m",
                "satellites",
                "hdop",
                "vdop",
            ]
        )
        sd = np.sqrt(np.einsum("mii->mi", fixes.cov_pos_n))
        for m in range(len(fixes)):
            time = (_EPOCH + timedelta(seconds=raw.origin) + timedelta(seconds=float(raw.t[m]))).isoformat()
            place = [f"{np.rad2deg(lla[m, 0]):.9f}", f"{np.rad2deg(lla[m, 1]):.9f}", f"{lla[m, 2]:.3f}"]
            speed = [f"{v:.4f}" for v in fixes.vel_n[m]]
            spread = [f"{s:.3f}" for s in sd[m]]
            dilution = [f"{dop.h[m]:.2f}", f"{dop.v[m]:.2f}"]
            rows.writerow(
                [time, int(fixes.valid[m]), *place, *speed, *spread, fixes.satellites[m], *dilution]
            )


def _days(nav: NavigationFile) -> str:
    t = np.concatenate([nav.kepler.t, nav.glonass.t])
    return f"{_day(float(t.min()))} to {_day(float(t.max()))}"


def _day(seconds: float) -> str:
    return str((_EPOCH + timedelta(days=seconds // DAY)).date())
