"""Bursts of wrong fixes on random motions: no filter is reset, and all are consistent soon after.

A burst moves fixes by 50 to 750 m, at 1 or 10 Hz, after 211 s without a fix or without an outage. The shapes:

- ``step``: one distance for the whole burst; the velocities are sound.
- ``walk``: a distance that grows evenly from zero; the velocities are sound.
- ``ramp``: the same distance, and the velocities are those of the moved track.
- ``jump``: one distance from the first fix on, which grows; the velocities are those of the moved track.

The positions of a step, a walk and a jump contradict the velocities, at an end of the burst or in it. Those
of a ramp agree until the burst ends: only an IMU shows the step of its velocity.
"""

from __future__ import annotations

import argparse
import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import product

import numpy as np

from bench.core.mathematics import earth
from bench.core.mathematics.arrays import FloatArray
from bench.core.records.data import GnssFixes, InitialState, SensorData, Trajectory
from bench.core.words.exceptions import EstimatorError
from bench.evaluation.errors.error_series import check_convergence, error_series
from bench.navigation import built_in
from bench.navigation.engine.piecewise import take_answers
from bench.simulation import sensors
from tests.motions import trials
from tests.motions.truths import RATE, Motion, make_truth

LENGTHS = (3.0, 10.0, 24.0)  # [s]
RATES = (1.0, 10.0)  # of fixes [Hz]
OUTAGES = (0.0, 211.0)  # before a burst [s]
SHAPES = ("step", "walk", "ramp", "jump")
FIRST = 45.0  # with sound fixes, before an outage or a burst [s]
RECOVERY = 40.0  # after a burst, from which on the filter is evaluated [s]
REST = 40.0  # evaluated [s]
LARGEST = 40.0  # mean NEES (9) over the rest; a consistent filter exceeds it in 1 of 130,000 runs, at most


@dataclass(frozen=True)
class Burst:
    """One run with a burst."""

    number: int
    kind: str
    unit: str
    receiver: str
    off: float  # the distance [m]
    resets: tuple[str, ...]  # what their events say
    lost: str  # why it did not converge, or is not consistent after `RECOVERY`; or ""
    anyway: tuple[bool, bool]  # it is reset, and lost, without the burst too
    nees: float  # mean after `RECOVERY`, n = 9
    farthest: float  # largest horizontal error from the burst on [m]


def lengthen(motion: Motion, seconds: float) -> Motion:
    """Return a motion of a length: back and forth, each time with its velocities in reverse order."""
    n = len(motion.vel_n) - 1
    rows = n - np.abs(np.arange(round(seconds * RATE) + 1) % (2 * n) - n)
    return replace(motion, vel_n=motion.vel_n[rows], euler=motion.euler[rows])


def move(fixes: GnssFixes, begin: float, length: float, off_n: FloatArray, shape: str) -> GnssFixes:
    """Return fixes with a burst from ``begin`` on for a ``length`` [s], off_n (3,) [m] away."""
    inside = (fixes.t >= begin) & (fixes.t < begin + length)
    grown = (fixes.t[inside, None] - begin) / length
    size = {"step": np.ones_like(grown), "jump": 1.0 + grown}.get(shape, grown)
    lla, vel_n = fixes.lla.copy(), fixes.vel_n.copy()
    lla[inside] = earth.displace(lla[inside], size * off_n)
    if shape in ("ramp", "jump"):
        vel_n[inside] += off_n / length
    return replace(fixes, lla=lla, vel_n=vel_n)


def run_burst(
    number: int, seed: int, length: float, rate: float, outage: float, shape: str,
    use: str = "loose-full", units: Sequence[str] = (),
) -> Burst:  # fmt: skip
    """Return the result of a filter on a random motion with a burst."""
    r = np.random.default_rng([seed, number])
    kind = str(r.choice(list(trials.KINDS)))
    begin = FIRST + outage + r.uniform(0.0, 1.0)
    end = begin + length
    motion = lengthen(trials.KINDS[kind](r), end + RECOVERY + REST)
    unit, receiver = str(r.choice(units or trials.list_units())), str(r.choice(trials.RECEIVERS))
    off, way = r.uniform(50.0, 750.0), r.uniform(0.0, 2.0 * np.pi)
    spec = trials.choose_start(trials.load_sensors(unit, receiver), motion, "given")
    assert spec.gnss is not None
    assert spec.assumed.gnss is not None
    assumed = replace(spec.assumed, gnss=replace(spec.assumed.gnss, rate=rate))
    spec = replace(spec, gnss=replace(spec.gnss, rate=rate), assumed=assumed)
    truth = make_truth(motion.vel_n, motion.euler)
    drawn = sensors.sense(truth, spec, seed, number)
    fixes = drawn.data.fixes
    assert fixes is not None
    sound = replace(drawn.data, fixes=fixes.take((fixes.t < begin - outage) | (fixes.t >= begin)))
    assert sound.fixes is not None
    moved = move(sound.fixes, begin, length, off * np.array([math.cos(way), math.sin(way), 0.0]), shape)
    found = _judge(truth, replace(sound, fixes=moved), drawn.initial, use, begin, end + RECOVERY)
    resets, lost, nees, farthest = found
    anyway = False, False
    if resets or lost:
        without = _judge(truth, sound, drawn.initial, use, begin, end + RECOVERY)
        anyway = bool(without[0]), bool(without[1])
    return Burst(number, kind, unit, receiver, off, resets, lost, anyway, nees, farthest)


def _judge(
    truth: Trajectory, data: SensorData, start: InitialState, use: str, begin: float, after: float
) -> tuple[tuple[str, ...], str, float, float]:
    """Return resets, why it is lost, NEES and largest error of a solution (`Burst`)."""
    try:
        solution = built_in.load(use, {}).run(data, start)
    except EstimatorError as error:
        return (), str(error), math.nan, math.nan
    resets = tuple(f"{t:.1f} s: {text}" for t, _, text in solution.events.select("reset"))
    errors = error_series(truth, solution)
    farthest = float(np.hypot(*errors.pos_n[errors.t > begin, :2].T).max())
    sound, why = check_convergence(errors, solution)
    rest = take_answers(solution, slice(int(np.searchsorted(solution.t, after)), None))
    errors = error_series(truth, rest)
    nees = float(errors.nees.mean())
    lost = "" if sound else str(why)
    if not lost and not nees < LARGEST:
        lost = f"mean NEES {nees:.0f}"
    return resets, lost, nees, farthest


def run_cell(
    runs: int, seed: int, cell: tuple[float, float, float, str], use: str, units: Sequence[str] = ()
) -> list[Burst]:
    """Return the runs of one cell: length, rate, outage and shape."""
    return [run_burst(k, seed, *cell, use, units) for k in range(runs)]


def count(found: Sequence[Burst], what: str) -> int:
    """Return the number of runs that are reset ("resets") or "lost" by the burst, not without it too."""
    k = ("resets", "lost").index(what)
    return sum(bool(getattr(one, what)) and not one.anyway[k] for one in found)


def write_cell(cell: tuple[float, float, float, str], found: Sequence[Burst]) -> str:
    """Return a line of the table."""
    length, rate, outage, shape = cell
    nees = np.array([one.nees for one in found])
    resets, lost = count(found, "resets"), count(found, "lost")
    reset_anyway, lost_anyway = (sum(one.anyway[k] for one in found) for k in (0, 1))
    return (
        f"{shape:5s} {length:3.0f} s {rate:3.0f} Hz {outage:4.0f} s  {len(found):4d} {resets:6d}"
        f" {reset_anyway:6d} {lost:5d} {lost_anyway:6d} {np.nanmedian(nees):7.1f} {np.nanmean(nees):8.1f}"
        f" {np.nanmedian([one.farthest for one in found]):9.1f}"
    )


def count_resets(runs: int, seed: int, use: str) -> dict[str, int]:
    """Return the number of runs without a burst by the reason of their first reset; "" has none.

    Each motion, of the first 90 s of a random one, is flown with four random sensors and alignments.
    """
    found: dict[str, int] = {}
    for number in range(runs):
        r = np.random.default_rng([seed, number // 4, 1])
        if number % 4 == 0:
            motion = trials.KINDS[str(r.choice(list(trials.KINDS)))](r)
            motion = replace(motion, vel_n=motion.vel_n[:9001], euler=motion.euler[:9001])
            truth = make_truth(motion.vel_n, motion.euler)
        r = np.random.default_rng([seed, number, 2])
        unit, receiver = str(r.choice(trials.list_units())), str(r.choice(trials.RECEIVERS))
        start = str(r.choice(("given", "unknown", *motion.starts)))
        drawn = sensors.sense(
            truth, trials.choose_start(trials.load_sensors(unit, receiver), motion, start), seed, number
        )
        try:
            resets = built_in.load(use, {}).run(drawn.data, drawn.initial).events.select("reset")
        except EstimatorError as error:
            resets = [(0.0, 0.0, f"failed: {error}")]
        why = resets[0][2].partition(":")[0] if resets else ""
        found[why] = found.get(why, 0) + 1
    return found


def list_cells(shapes: Sequence[str]) -> list[tuple[float, float, float, str]]:
    """Return the cells of the table."""
    return [(a, b, c, shape) for shape, a, b, c in product(shapes, LENGTHS, RATES, OUTAGES)]


def main() -> None:
    """Print a line for each cell, and the runs with a reset or lost."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--runs", type=int, default=40)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--filter", default="loose-full")
    parser.add_argument("--units", default="", help="all by default")
    parser.add_argument("--shapes", default="step")
    parser.add_argument("--sound", action="store_true", help="count the resets of runs without a burst")
    given = parser.parse_args()
    if given.sound:
        print(count_resets(given.runs, given.seed, given.filter))
        return
    print("shape len  rate  outage  runs resets anyway  lost anyway  median     mean  farthest [m]")
    for cell in list_cells(given.shapes.split(",")):
        units = given.units.split(",") if given.units else ()
        found = run_cell(given.runs, given.seed, cell, given.filter, units)
        print(write_cell(cell, found), flush=True)
        for one in found:
            if (one.resets and not one.anyway[0]) or (one.lost and not one.anyway[1]):
                print(f"   {one}", flush=True)


if __name__ == "__main__":
    main()
