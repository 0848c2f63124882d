"""Consistency of a filter on random motions, with random IMUs, receivers and alignments.

Each trial draws all of them from its own seed. NEES is averaged over the epochs of a run first. The interval
of the mean over runs follows from the scatter between runs, because errors that last a run make its epochs
dependent. The error of a heading with a sigma above `VAGUE` is not normal: its epochs are left out of NEES,
and the fraction of its errors within 1.645 sigma is reported (0.9 if they were normal).
"""

from __future__ import annotations

import json
import math
from collections.abc import Iterable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import asdict, dataclass, replace
from functools import cache
from multiprocessing import get_context
from pathlib import Path

import numpy as np
from scipy.special import stdtr, stdtrit

from bench.core.mathematics.arrays import FloatArray
from bench.core.records.data import NavSolution
from bench.core.records.sensor_specs import SensorsSpec
from bench.core.words.exceptions import EstimatorError
from bench.evaluation.errors.error_series import ErrorSeries, check_convergence, error_series
from bench.io.config import read_profile
from bench.navigation import built_in
from bench.simulation import sensors
from tests.motions import flown, held
from tests.motions.truths import Kind, Motion, make_truth

KINDS: dict[str, Kind] = {**held.KINDS, **flown.KINDS}
RECEIVERS = ("l1-code", "zed-f9p", "rtk-fixed")
SKIES = ("sky-l1", "sky-l1l2", "sky-multi")  # with satellites, where one of the filters is tight
VAGUE = float(np.deg2rad(30.0))
BLOCKS = {"position": slice(0, 3), "velocity": slice(3, 6), "attitude": slice(6, 9), "heading": slice(8, 9)}
_NINETY = 1.645


@dataclass(frozen=True)
class Trial:
    """One run of a filter: what was drawn, and what came out; NaN where nothing was judged."""

    kind: str
    unit: str
    receiver: str
    start: str
    number: int
    use: str
    nees: float  # mean over the answers, n = 9
    blocks: dict[str, float]  # NEES of each block over its number of states
    vague: int  # epochs with a heading sigma above `VAGUE`
    covered: int  # of them within 1.645 sigma
    lost: str  # why it did not converge, or ""
    figures: dict[str, float]
    resets: int = 0  # of the filter, by rejected fixes or an unknown heading


UNITS = (
    "adis16475", "adis16495", "bmi088", "grade-1", "grade-2", "grade-3", "hg1700", "hg4930-ca51", "hg9900",
    "icm-20948", "icm-42688-p", "icm-45686", "kvh-dsp-1760", "ln-100", "ln-200", "lsm6dsl", "matched-mems",
    "mpu-6050", "mpu-9250", "mti-300", "stim300", "vn-100",
)  # fmt: skip
"""IMUs of all classes; a list, so that a seed keeps its trials when the catalog grows."""


def list_units() -> tuple[str, ...]:
    """Return the names of the IMUs of the trials."""
    return UNITS


@cache
def load_sensors(unit: str, receiver: str) -> SensorsSpec:
    """Return the sensors of a trial, as assumed."""
    return read_profile("figure-eight", {"sensors.imu": unit, "sensors.gnss": receiver}).sensors


def choose_start(spec: SensorsSpec, motion: Motion, start: str) -> SensorsSpec:
    """Return sensors with the alignment of a trial."""
    spec = replace(spec, output_rate=1.0, gnss_outages=(), faults=())
    if start == "unknown":
        return replace(spec, alignment="given", initial_heading_sd=np.pi)
    if start == "level":
        return replace(spec, alignment="level", align_for=min(60.0, motion.rest - 0.5))
    if start == "course":
        return replace(spec, alignment="course", align_for=10.0, drift_sd=np.deg2rad(motion.drift_deg))
    return replace(spec, alignment="given")


def run_trial(
    kind: str, number: int, seed: int, uses: Sequence[str], units: Sequence[str] = ()
) -> list[Trial]:
    """Return the results of filters on one random motion with random sensors."""
    r = np.random.default_rng([seed, number, sorted(KINDS).index(kind)])
    motion = KINDS[kind](r)
    unit = str(r.choice(units or list_units()))
    receiver = str(r.choice(SKIES if "tight" in uses else RECEIVERS))
    start = str(r.choice(("given", "unknown", *motion.starts)))
    truth = make_truth(motion.vel_n, motion.euler)
    spec = choose_start(load_sensors(unit, receiver), motion, start)
    drawn = sensors.sense(truth, spec, seed, number)
    begin = {"level": motion.rest, "course": 20.0}.get(start, 0.0)
    data = replace(drawn.data, output_t=drawn.data.output_t[drawn.data.output_t >= begin])
    found = []
    for use in uses:
        label = (kind, unit, receiver, start, number, use)
        try:
            solution = built_in.load(use, {}).run(data, drawn.initial)
        except EstimatorError as error:
            found.append(Trial(*label, math.nan, {}, 0, 0, str(error), motion.figures))
            continue
        errors = error_series(truth, solution)
        found.append(_judge(label, errors, solution, motion.figures))
    return found


def _judge(
    label: tuple[str, str, str, str, int, str],
    errors: ErrorSeries,
    solution: NavSolution,
    figures: dict[str, float],
) -> Trial:
    """Return the trial of a solution."""
    sound, why = check_convergence(errors, solution)
    chosen = errors.t > errors.t[0] + 0.5
    cov, heading = solution.cov[chosen], errors.heading[chosen]
    error = np.hstack([errors.pos_n, errors.vel_n, errors.phi_n])[chosen]
    sd = np.sqrt(cov[:, 8, 8])
    vague = sd > VAGUE
    known = ~vague
    nees = errors.nees[chosen]
    blocks = {}
    for name, part in BLOCKS.items():
        rows = known if name in ("attitude", "heading") else np.ones(len(cov), np.bool_)
        ratio = _squares(error[rows][:, part], cov[rows][:, part, part])
        blocks[name] = float(ratio.mean()) if rows.any() else math.nan
    return Trial(
        *label,
        float(nees[known].mean()) if known.any() else math.nan,
        blocks,
        int(vague.sum()),
        int((np.abs(heading[vague]) < _NINETY * sd[vague]).sum()),
        "" if sound else str(why),
        figures,
        sum(row[2] == "reset" for row in solution.events.rows()),
    )


def _squares(error: FloatArray, cov: FloatArray) -> FloatArray:
    """Return e' P^-1 e over its number of states (K,)."""
    return np.einsum("ki,ki->k", error, np.linalg.solve(cov, error[..., None])[..., 0]) / error.shape[1]


def run_trials(
    count: int, seed: int, uses: Sequence[str], kinds: Sequence[str] = (), units: Sequence[str] = ()
) -> Iterator[Trial]:
    """Yield the results of ``count`` trials of each kind, by two processes."""
    jobs = [(kind, k) for k in range(count) for kind in kinds or KINDS]
    with ProcessPoolExecutor(2, mp_context=get_context("fork")) as pool:
        waiting = [pool.submit(run_trial, kind, k, seed, uses, units) for kind, k in jobs]
        for one in waiting:
            yield from one.result()


def summarize(trials: Sequence[Trial]) -> Iterator[str]:
    """Yield the lines of the table, a motion each, and of the pairs of motion and unit that stand out."""
    blocks = "   ".join(name[:3] for name in BLOCKS)
    yield f"{'motion':24s} {'filter':11s} runs lost reset   NEES (9)      median  worst   {blocks}  vague"
    for use in dict.fromkeys(one.use for one in trials):
        own = [one for one in trials if one.use == use]
        for kind in dict.fromkeys(one.kind for one in own):
            yield _line(kind, use, [one for one in own if one.kind == kind])
        yield _line("all", use, own)
        yield from (f"  {line}" for line in list_pairs(own))


def _line(kind: str, use: str, own: Sequence[Trial]) -> str:
    nees = np.array([one.nees for one in own if not math.isnan(one.nees)])
    half = stdtrit(max(len(nees) - 1, 1), 0.995) * nees.std(ddof=1) / np.sqrt(len(nees))
    blocks = [np.nanmean([one.blocks.get(name, math.nan) for one in own]) for name in BLOCKS]
    vague, covered = sum(one.vague for one in own), sum(one.covered for one in own)
    share = f"{covered / vague:.2f} of {vague}" if vague else "-"
    lost, resets = sum(bool(one.lost) for one in own), sum(one.resets for one in own)
    return (
        f"{kind:24s} {use:11s} {len(own):4d} {lost:4d} {resets:5d} {nees.mean():7.2f} ± {half:6.2f}"
        f"  {np.median(nees):6.2f} {nees.max():7.1f} {' '.join(f'{x:5.2f}' for x in blocks)}  {share}"
    )


def list_pairs(trials: Sequence[Trial]) -> list[str]:
    """Return the pairs of motion and unit whose NEES is above the median of all runs, by Holm's test at 1 %.

    One-sided, by Student's t on the logarithms of the means of runs, whose distribution is skewed.
    """
    usual = float(np.median(np.log([one.nees for one in trials if one.nees > 0.0])))
    found = []
    pairs = dict.fromkeys((one.kind, one.unit) for one in trials)
    for kind, unit in pairs:
        logs = np.log([one.nees for one in trials if (one.kind, one.unit) == (kind, unit) and one.nees > 0.0])
        if len(logs) > 2:
            t = (logs.mean() - usual) / (logs.std(ddof=1) / np.sqrt(len(logs)))
            found.append(
                (1.0 - float(stdtr(len(logs) - 1, t)), kind, unit, len(logs), float(np.exp(logs.mean())))
            )
    found.sort()
    lines = []
    for k, (p, kind, unit, count, mean) in enumerate(found):
        if p * (len(found) - k) > 0.01:
            break
        lines.append(f"{kind}, {unit}: geometric mean {mean:.1f} of {count} runs, p {p:.2g}")
    return lines


def write_table(trials: Sequence[Trial]) -> Iterator[str]:
    """Yield the lines of the table of the guide: a motion each."""
    yield "| motion | runs | diverged | mean NEES (9) | median | unknown headings within 1.645 sigma |"
    yield "|---|---|---|---|---|---|"
    for kind in dict.fromkeys(one.kind for one in trials):
        own = [one for one in trials if one.kind == kind]
        nees = np.array([one.nees for one in own if not math.isnan(one.nees)])
        half = stdtrit(len(nees) - 1, 0.975) * nees.std(ddof=1) / np.sqrt(len(nees))
        vague, covered = sum(one.vague for one in own), sum(one.covered for one in own)
        lost = sum(bool(one.lost) for one in own)
        cells = [kind, str(len(own)), str(lost), f"{nees.mean():.1f} ± {half:.1f}", f"{np.median(nees):.1f}"]
        yield "| " + " | ".join([*cells, f"{covered / vague:.2f}" if vague else "-"]) + " |"


def save(trials: Iterable[Trial], path: Path) -> None:
    """Add trials to a file, a line of JSON each."""
    with path.open("a") as file:
        file.writelines(json.dumps(asdict(one)) + "\n" for one in trials)


def load(path: Path) -> list[Trial]:
    """Return the trials of a file."""
    return [Trial(**json.loads(line)) for line in path.read_text().splitlines()]
