"""Solve the files of a receiver by options in the units of a user: degrees, hPa, Celsius, percent."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from math import radians
from pathlib import Path
from typing import get_args

from bench.core.records.orbit_sets import parse_systems
from bench.core.words.exceptions import ConfigError
from bench.plugins.receiver.fix_truth import read_truth
from bench.plugins.receiver.rinex_fixes import RinexFixes, solve_files
from bench.simulation.signals import delays
from bench.simulation.signals.processing import CORRECTIONS, Ionosphere, Processing

MOST_TRUTH_SD = 1000.0
"""Largest standard deviation of a reference [m]."""


def solve_rinex(
    observations: str | Path | Sequence[str | Path],
    navigation: str | Path | Sequence[str | Path],
    *,
    systems: str = "all",
    ionosphere: Ionosphere = "klobuchar",
    troposphere: delays.Troposphere = "saastamoinen",
    mapping: delays.Mapping = "do-229",
    pressure_hpa: float = 1013.25,
    temperature_c: float = 15.0,
    humidity_pct: float = 50.0,
    mask_deg: float = 10.0,
    robust: bool = False,
    smooth_s: float = 0.0,
    without: Sequence[str] = (),
    truth: str | Path | None = None,
    truth_sd_m: float = 0.0,
) -> RinexFixes:
    """Compute GNSS fixes from RINEX 2, 3 or 4 files, epoch by epoch.

    Parameters
    ----------
    observations : str, Path or sequence of them
        RINEX, UBX, SBF or RTCM 3 files of one receiver, packed or not.
    navigation : str, Path or sequence of them
        RINEX navigation files and SP3 files.
    systems : str, optional
        "gps", "glonass", "galileo", "beidou", or several with commas between; "both": GPS and GLONASS; "all";
        "auto": at each epoch those with the smallest PDOP times standard deviation.
    ionosphere : {"klobuchar", "ntcm-g", "none", "free"}
        Delay of the first carrier from the broadcast parameters of GPS or of Galileo; none; or the
        ionosphere-free combination of two carriers.
    troposphere : {"saastamoinen", "unb3m", "b-10"}
        Model of the vertical delay.
    mapping : {"do-229", "cosecant"}
        Ratio of slant to vertical delay.
    pressure_hpa, temperature_c, humidity_pct : float, optional
        Air at sea level for "saastamoinen" [hPa, deg C, %].
    mask_deg : float, optional
        Lowest elevation used [deg].
    robust : bool, optional
        Give large residuals less weight (IGG III), for places with reflections.
    smooth_s : float, optional
        Longest smoothing of ranges with their carrier phase (Hatch) [s]. Default: 0, none.
    without : sequence of str, optional
        Corrections to leave out, of `bench.simulation.signals.processing.CORRECTIONS`.
    truth : str or Path, optional
        True position: "LAT,LON,H" [deg, deg, m], or a CSV file as ``write_csv`` writes it.
    truth_sd_m : float, optional
        Standard deviation of the true position along each axis [m]. It is one error common to all epochs, so
        NEES has the mean 1, but a record is one realization, of any length.

    Returns
    -------
    RinexFixes
        ``fixes`` of the antenna [rad, rad, m; m/s, n], ``figures()`` of their errors, ``write_csv(path)``.

    Raises
    ------
    bench.ConfigError
        If an option or a file is wrong.

    Examples
    --------
    >>> import bench
    >>> solved = bench.solve_rinex("site.rnx", "brdc.rnx")  # doctest: +SKIP
    >>> solved.write_csv("fixes.csv")  # doctest: +SKIP
    """
    try:
        parse_systems(systems)
    except ValueError as error:
        raise ConfigError(str(error)) from None
    _check_choice("ionosphere", [ionosphere], get_args(Ionosphere))
    _check_choice("troposphere", [troposphere], get_args(delays.Troposphere))
    _check_choice("mapping", [mapping], get_args(delays.Mapping))
    _check_choice("without", without, CORRECTIONS)
    if not 0 <= truth_sd_m <= MOST_TRUTH_SD:
        raise ConfigError(f"truth_sd_m = {truth_sd_m!r} must be 0 to {MOST_TRUTH_SD:g} [m]")
    weather = delays.SurfaceAir(100.0 * pressure_hpa, 273.15 + temperature_c, humidity_pct / 100.0)
    processing = Processing(
        systems=systems,
        ionosphere=ionosphere,
        troposphere=troposphere,
        mapping=mapping,
        weather=weather,
        mask=radians(mask_deg),
        robust=robust,
        without=frozenset(without),
    )
    known = None if truth is None else read_truth(str(truth))
    solved = solve_files(_list(observations), _list(navigation), processing, truth=known, window=smooth_s)
    solved = replace(solved, truth_sd=float(truth_sd_m))
    header = solved.observations.approximate_e is not None
    if known is None and header and solved.fixes.valid.any() and solved.moving:
        note = "the receiver moves: its fixes are not compared with the position in the header"
        solved = replace(solved, notes=(*solved.notes, note))
    return solved


def _list(files: str | Path | Sequence[str | Path]) -> list[Path]:
    return [Path(file) for file in ([files] if isinstance(files, str | Path) else files)]


def _check_choice(name: str, given: Sequence[str], choices: Sequence[str]) -> None:
    for one in given:
        if one not in choices:
            raise ConfigError(f"{name} = {one!r} must be one of {', '.join(choices)}")
