"""The ranges of a receiver beside a recorded IMU: its fixes, and the observations for tight coupling."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np

from bench.core.mathematics.arrays import FloatArray, IntArray
from bench.core.records.data import GnssObservations
from bench.core.records.sensor_specs import GnssSpec
from bench.core.records.sky_spec import SkySpec
from bench.io.fix_readers import RecordedRanges
from bench.io.logs.rows import LogRows
from bench.navigation.engine.kept_rows import take_rows
from bench.plugins.receiver.rinex_fixes import RinexFixes, solve_files
from bench.simulation.sensors.measurement_level.loops import find_loop_noise, make_processing
from bench.simulation.signals import receiver_solution
from bench.simulation.signals.orbits import C
from bench.simulation.signals.processing import Processing


def read_ranges(
    observations: Sequence[Path], navigation: Sequence[Path], time_offset: float, gnss: GnssSpec
) -> RecordedRanges:
    """Solve the files of a receiver.

    Times are those of validity: by the receiver's clock, less its offset as the fixes have it, in GPS time
    since 1980-01-06 plus the offset [s]. Noise, masks, systems and carriers are those of the
    datasheet that the filters assume; a satellite that states a worse accuracy counts as that.

    Raises
    ------
    ConfigError
        If a file is wrong, or no ephemeris fits.
    """
    sky = gnss.sky
    processing = Processing() if sky is None else _make_processing(sky)
    loops = None if sky is None else partial(_find_noise, sky)
    solved = solve_files(observations, navigation, processing, loops=loops)
    t = solved.observations.origin + solved.observations.t - _find_clock(solved) / C
    t = t + time_offset
    fixes, good = solved.fixes, solved.fixes.valid
    values = {
        "lla": fixes.lla[good],
        "vel_n": fixes.vel_n[good],
        "cov_pos": fixes.cov_pos_n[good].reshape(-1, 9),
        "cov_vel": fixes.cov_vel_n[good].reshape(-1, 9),
        "satellites": fixes.satellites[good].astype(float),
    }
    ranges, lack = None, ""
    if sky is None:
        lack = "[sensors.assumed] gnss has no [sky]: filters get its fixes, not its ranges"
    else:
        ranges = _take_whole(solved, sky, t)
        lack = "" if len(ranges) else "no satellite has both a range and a Doppler"
    notes = [f"{solved.observations.shown}: {note}" for note in (*solved.notes, lack) if note]
    rows = LogRows(t[good], values, tuple(notes))
    return RecordedRanges(rows, ranges, solved.view_sky(t), lack)


def _make_processing(sky: SkySpec) -> Processing:
    processing = make_processing(sky)
    budget = processing.budget._replace(space=sky.space_sd, space_beidou_2=sky.beidou_space_sd)
    return replace(processing, budget=budget)


def _find_noise(
    sky: SkySpec, system: IntArray, cn0: FloatArray, frequency: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Return the noise of the loops; without C/N0 it counts as half way from horizon to zenith."""
    known = np.where(np.isfinite(cn0), cn0, 0.5 * (sky.cn0_horizon + sky.cn0_zenith))
    return find_loop_noise(system, known, frequency, sky)


def _find_clock(solved: RinexFixes) -> FloatArray:
    """Return the offset of the receiver's clock (M,) [m] by its fixes, in between as a line has it."""
    clock = solved.solution.clock
    known = np.isfinite(clock)
    first = clock[np.arange(len(clock)), np.argmax(known, axis=1)]
    good = known.any(axis=1) & solved.fixes.valid
    if not good.any():
        return np.zeros(len(clock))
    t = solved.observations.t
    return np.asarray(np.interp(t, t[good], first[good]))


def _take_whole(solved: RinexFixes, sky: SkySpec, t: FloatArray) -> GnssObservations:
    """Return the rows with range, Doppler and orbit of the systems of the sky, at times t (M,)."""
    o = solved.seen
    o = replace(o, t=t[o.epoch], t_arrival=t[o.epoch])
    ranges = receiver_solution.correct_pseudoranges(o, make_processing(sky))
    rates = o.range_rate[:, 0] + o.sat_clock_rate
    whole = np.isin(o.system, sky.constellations) & np.isfinite(o.sat_pos_e).all(axis=1)
    return take_rows(o, np.asarray(whole & np.isfinite(ranges) & np.isfinite(rates)))
