"""Is a filter consistent on every profile and unit? NEES over many runs beside that of a twin.

The twin is the same filter on the same runs of sensors that have no error but those it models: biases as
Gauss-Markov processes, white noise, no quantization, no jumps (:func:`without_unmodeled`). Both are evaluated
by `bench.evaluation.ensembles.ensemble_consistency`. Run as a program it prints a row for each pair::

    python -m tests.navigation.honesty --profiles survey,static --units adis16475,bmi088 --runs 150 --twin

With ``-o`` it also keeps the rows, and ``--table`` prints the tables of the guide from them. With
``--motions 100`` it runs 100 random motions of each kind (`tests.motions.trials`).
"""

from __future__ import annotations

import argparse
import json
import math
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
from scipy.special import stdtrit

import bench
from bench import pipeline
from bench.core.mathematics.arrays import BoolArray, FloatArray
from bench.core.records.data import Trajectory
from bench.core.records.sensor_specs import (
    AssumedSpecs,
    ImuSpec,
    SensorsSpec,
    ThermalSpec,
    TriadSpec,
    VibrationSpec,
)
from bench.core.records.specs import Profile
from bench.evaluation.consistency import chi_square
from bench.evaluation.consistency.chi_square import SensorNis
from bench.evaluation.ensembles import ensemble_consistency
from bench.evaluation.errors.error_series import check_convergence, error_series
from bench.navigation import built_in, estimator
from tests.measured import SHOWN, stamp, write_measured
from tests.motions import trials

FOLDER = Path(bench.__file__).parent
RECOVERY = 60.0  # after a fault, in which no consistency is asked for [s]
ALLOWED, CONFIDENCE = (
    0.10,
    0.99,
)  # distance of the ratio from 1, and of the interval that the word follows from
SEED = 90210  # of the evaluation runs; no model was built on them


@dataclass
class Judged:
    """NEES and NIS of one filter on the runs of one profile and unit."""

    profile: str
    unit: str
    use: str
    states: int = 9
    nees: list[FloatArray] = field(default_factory=list)  # (M,) of each run at the evaluated epochs
    nis: dict[str, list[Any]] = field(default_factory=dict)  # by sensor, a series of each run
    apart: list[FloatArray] = field(default_factory=list)  # (M, 3) position error of each run [m], n
    failed: int = 0  # runs that did not converge by the rule of a run, from the first answer on

    @property
    def averages(self) -> FloatArray:
        """NEES of each run averaged over time."""
        return np.array([row.mean() for row in self.nees])

    @property
    def mean(self) -> float:
        """NEES over all runs."""
        return float(self.averages.mean()) if self.nees else math.nan

    @property
    def error(self) -> float:
        """Standard error of the mean."""
        return float(self.averages.std(ddof=1) / np.sqrt(len(self.nees))) if len(self.nees) > 1 else math.nan

    def rmse(self, axes: slice) -> float:
        """Return the RMSE of position along some axes, n, over all runs [m]."""
        if not self.apart:
            return math.nan
        return float(np.sqrt(np.mean(np.sum(np.concatenate(self.apart)[:, axes] ** 2, axis=1))))

    def outside(self) -> list[str]:
        """Return the sensors whose mean NIS is outside its 99.9 % band, each with its mean over its dof."""
        found = self.innovations().items()
        return [f"{sensor} {ratio:.3f}" for sensor, (ratio, inside) in found if not inside]

    def innovations(self) -> dict[str, tuple[float, bool]]:
        """Return mean NIS over its dof of each sensor, and whether it is in its 99.9 % band."""
        found = {}
        for sensor, each in self.nis.items():
            nis, dof = (np.concatenate([getattr(series, name) for series in each]) for name in ("nis", "dof"))
            found[sensor] = (float(nis.sum() / dof.sum()), bool(chi_square.mean_nis(nis, dof).inside))
        return found

    def claims(self) -> ensemble_consistency.Consistency:
        """Return the verdict of the rule for many runs."""
        return ensemble_consistency.check_consistency(np.array(self.nees), self.states, self.nis)

    def row(self, twin: Judged | None = None) -> dict[str, Any]:
        """Return the figures of a line of the table."""
        averages = self.averages
        figures: dict[str, Any] = {
            "profile": self.profile,
            "unit": self.unit,
            "use": self.use,
            "draws": len(averages),
            "failed": self.failed,
            "mean": self.mean,
            "error": self.error,
            "median": float(np.median(averages)) if len(averages) else math.nan,
            "most": float(averages.max()) if len(averages) else math.nan,
            "horizontal": self.rmse(slice(0, 2)),
            "vertical": self.rmse(slice(2, 3)),
            "nis": self.outside(),
            "innovations": self.innovations(),
            "averages": averages.tolist(),
        }
        if len(averages) >= ensemble_consistency.LEAST_RUNS:
            figures["word"] = self.claims().word
        if twin is not None and self.failed == twin.failed == 0:
            ratio = self.mean / twin.mean
            apart = (averages - ratio * twin.averages) / twin.mean
            figures |= {
                "twin": twin.mean,
                "ratio": ratio,
                "ratio_error": float(apart.std(ddof=1) / np.sqrt(len(apart))),
                "twin_innovations": twin.innovations(),
                "twin_averages": twin.averages.tolist(),
            }
        return figures


def without_unmodeled(sensors: SensorsSpec) -> SensorsSpec:
    """Return sensors that have only errors `loose-full` models exactly, assumed as they are."""
    imu = replace(
        sensors.imu,
        gyro=_modeled(sensors.imu.gyro),
        accel=_modeled(sensors.imu.accel),
        thermal=ThermalSpec(),
        vibration=VibrationSpec(),
        accel_cone=0.0,
        accel_arms=(),
    )
    gnss = sensors.gnss and replace(
        sensors.gnss,
        sky=None,
        latency=0.0,
        optimism=1.0,
        pos_h_jump_sd=0.0,
        pos_v_jump_sd=0.0,
        vel_jump_sd=0.0,
        pos_h_jump_markov_sd=0.0,
        pos_v_jump_markov_sd=0.0,
        vel_jump_markov_sd=0.0,
    )
    baro = sensors.baro and replace(sensors.baro, physical=None, quantization=0.0, latency=0.0)
    assumed = replace(sensors.assumed, imu=imu, gnss=gnss, baro=baro)
    return replace(sensors, imu=imu, gnss=gnss, baro=baro, assumed=assumed, faults=())


def _modeled(triad: TriadSpec) -> TriadSpec:
    """Return a triad without the errors that are no linear process, its flicker a Gauss-Markov process."""
    return replace(
        triad,
        bias_model="gauss-markov",
        resolution=0.0,
        temperature_sd=0.0,
        nonlinearity_sd=0.0,
        quadratic_sd=0.0,
        scale_asymmetry_sd=0.0,
        g2_sensitivity_sd=0.0,
        quantization=0.0,
        dead_zone=0.0,
        bandwidth=0.0,
        delay=0.0,
    )


def with_unit(profile: Profile, imu: ImuSpec) -> Profile:
    """Return a profile with another IMU on board, and assumed."""
    assumed: AssumedSpecs = replace(profile.sensors.assumed, imu=imu)
    return replace(profile, sensors=replace(profile.sensors, imu=imu, assumed=assumed))


def choose_instants(profile: Profile, t: FloatArray) -> BoolArray:
    """Return the epochs that are evaluated: after the alignment, at whole seconds, away from faults."""
    return (t >= profile.evaluation.begin) & (np.abs(t - np.round(t)) < 1e-6) & find_sound(profile, t)


def find_sound(profile: Profile, t: FloatArray) -> BoolArray:
    """Return the epochs that no fault reaches."""
    sound = np.ones(len(t), np.bool_)
    for fault in profile.sensors.faults:
        sound &= (t < fault.start) | (t >= fault.end + RECOVERY)
    return sound


def judge_draws(
    profile: Profile,
    truth: Trajectory,
    unit: str,
    uses: Sequence[tuple[str, dict[str, Any]]],
    runs: Iterable[int],
) -> list[Judged]:
    """Return the NEES and NIS of filters over runs; all get the same sensors."""
    found = [Judged(profile.name, unit, use) for use, _ in uses]
    built = [built_in.load(use, options) for use, options in uses]
    for run in runs:
        sensed = pipeline.sense(profile, truth, run)
        for one, judged in zip(built, found, strict=True):
            solution = estimator.answer(one, judged.use, sensed.data, sensed.initial)
            errors = error_series(truth, solution)
            chosen = choose_instants(profile, errors.t)
            judged.failed += not check_convergence(errors, solution)[0]
            if not np.isfinite(errors.nees[chosen]).all():
                continue
            judged.states = errors.states
            judged.nees.append(errors.nees[chosen])
            judged.apart.append(errors.pos_n[chosen])
            series = chi_square.nis_by_sensor(solution.innovations, profile.evaluation.begin)
            for sensor, each in series.items():
                sound = find_sound(profile, each.t)
                kept = SensorNis(each.t[sound], each.nis[sound], each.dof[sound], each.accepted[sound])
                judged.nis.setdefault(sensor, []).append(kept)
    return found


def list_names(kind: str) -> list[str]:
    """Return the names of the shipped profiles ("profiles") or IMUs ("catalog/imu")."""
    return sorted(path.stem for path in (FOLDER / kind).glob("*.toml"))


def measure(
    profiles: Sequence[str],
    units: Sequence[str],
    uses: Sequence[str],
    runs: int,
    seed: int,
    *,
    hz: float | None = 20.0,
    twin: bool = False,
    receiver: str = "own",
) -> Iterator[dict[str, Any]]:
    """Yield a row for each profile, unit and receiver ("own": that of the profile) and estimator."""
    on_board = {} if receiver == "own" else {"sensors.gnss": receiver}
    for name in profiles:
        flown = bench.read_profile(name, on_board)
        truth = bench.fly(flown)
        for unit in units:
            overrides = {} if unit == "own" else {"sensors.imu": unit}
            profile = replace(
                bench.read_profile(name, {**on_board, **overrides, "evaluation.output_hz": 1.0}), seed=seed
            )
            label = profile.sensors.imu.name if unit == "own" else unit
            pairs = [
                (use, {"covariance_hz": hz} if hz and built_in.takes_option(use, "covariance_hz") else {})
                for use in uses
            ]
            found = judge_draws(profile, truth, label, pairs, range(runs))
            others: list[Judged | None] = [None] * len(found)
            if twin:
                plain = replace(profile, sensors=without_unmodeled(profile.sensors))
                others = list(judge_draws(plain, truth, label, pairs, range(runs)))
            for judged, other in zip(found, others, strict=True):
                yield judged.row(other)


def write_row(row: dict[str, Any]) -> str:
    """Return a row as a line of text."""
    line = (
        f"{row['profile']:22s} {row['unit']:13s} {row['use']:11s} {row['mean']:8.2f} +- {row['error']:6.2f}"
        f"  median {row['median']:6.2f}  most {row['most']:8.1f}"
        f"  RMSE {row['horizontal']:6.3f} {row['vertical']:6.3f} m"
    )
    if row["failed"]:
        line += f"  failed {row['failed']}"
    if "twin" in row:
        line += f"  twin {row['twin']:5.2f}  ratio {row['ratio']:5.3f} +- {row['ratio_error']:.3f}"
    return " ".join([line, row.get("word", ""), *row["nis"]])


def judge_ratio(row: dict[str, Any]) -> tuple[float, str]:
    """Return half of the interval of a ratio to the twin that is shown, and the word about 10 %."""
    half, wide = (
        float(stdtrit(row["draws"] - 1, 0.5 + 0.5 * part) * row["ratio_error"])
        for part in (SHOWN, CONFIDENCE)
    )
    low, high = row["ratio"] - wide, row["ratio"] + wide
    near = [abs(end - 1.0) <= ALLOWED for end in (low, high)]
    if all(near):
        return half, "within"
    return half, "undecided" if any(near) or low < 1.0 < high else "outside"


def write_table(rows: Iterable[dict[str, Any]], key: str) -> Iterator[str]:
    """Yield the lines of a table of the guide, a line for each profile or unit (``key``)."""
    yield f"| {key} | runs | `loose-full` | twin | ratio | 10 % |"
    yield "|---|---|---|---|---|---|"
    out = []
    for row in rows:
        half, word = judge_ratio(row)
        cells = [f"`{row[key]}`", str(row["draws"]), f"{row['mean']:.2f}", f"{row['twin']:.2f}"]
        yield "| " + " | ".join([*cells, f"{row['ratio']:.3f} ± {half:.3f}", word]) + " |"
        if row["nis"]:
            out.append(f"`{row[key]}` {', '.join(row['nis'])}")
    yield ""
    yield f"Mean NIS over its expectation, if outside the 99.9 % band: {'; '.join(out) or 'none'}."


def write_pools(rows: Sequence[dict[str, Any]], key: str) -> Iterator[str]:
    """Yield the lines of a table of the guide that pools pairs by unit or profile (``key``)."""
    other = {"unit": "profile", "profile": "unit"}[key]
    yield f"| {key} | runs | lost | NEES | largest mean | of |"
    yield "|---|---|---|---|---|---|"
    for name in sorted({row[key] for row in rows}):
        own = [row for row in rows if row[key] == name]
        averages = np.concatenate([row["averages"] for row in own])
        worst = max(own, key=lambda row: row["mean"])
        cells = [f"`{name}`", str(len(averages)), str(sum(row["failed"] for row in own))]
        yield (
            "| "
            + " | ".join([*cells, f"{averages.mean():.2f}", f"{worst['mean']:.1f}", f"`{worst[other]}`"])
            + " |"
        )


def main() -> None:
    """Print a row for each profile, unit and estimator."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--profiles", default=",".join(list_names("profiles")))
    parser.add_argument("--units", default="own", help="names, 'own' or 'all'")
    parser.add_argument("--estimators", default="loose-full")
    parser.add_argument("--receiver", default="own", help="a name, or 'own'")
    parser.add_argument("--runs", type=int, default=10)
    parser.add_argument("--seed", type=int, default=SEED)
    parser.add_argument("--hz", type=float, default=20.0, help="of the covariance; 0: at every sample")
    parser.add_argument("--twin", action="store_true")
    parser.add_argument(
        "--motions", type=int, metavar="N", help="of each kind of motion, instead of profiles"
    )
    parser.add_argument("--kinds", default="", help="of --motions; all by default")
    parser.add_argument("-o", "--out", type=Path, help="rows as JSON, one a line")
    parser.add_argument(
        "--table", type=Path, metavar="OUT", help="print rows that were kept, and measure nothing"
    )
    given = parser.parse_args()
    if given.table:
        rows = [json.loads(line) for line in given.table.read_text().splitlines()]
        if "kind" in rows[0]:
            print("\n".join(trials.write_table(trials.load(given.table))))
            return
        if all("twin" not in row for row in rows):
            print("\n".join([*write_pools(rows, "unit"), "", *write_pools(rows, "profile")]))
            print(write_measured(row["measured"] for row in rows))
            return
        key = "unit" if len({row["profile"] for row in rows}) == 1 else "profile"
        print("\n".join([*write_table(rows, key), write_measured(row["measured"] for row in rows)]))
        return
    if given.motions:
        kinds = given.kinds.split(",") if given.kinds else tuple(trials.KINDS)
        found = list(trials.run_trials(given.motions, given.seed, given.estimators.split(","), kinds))
        if given.out:
            trials.save(found, given.out)
        print("\n".join(trials.summarize(found)))
        return
    units = list_names("catalog/imu") if given.units == "all" else given.units.split(",")
    rows = measure(
        given.profiles.split(","), units, given.estimators.split(","), given.runs, given.seed,
        hz=given.hz or None, twin=given.twin, receiver=given.receiver,
    )  # fmt: skip
    for row in rows:
        print(write_row(row), flush=True)
        if given.out:
            with given.out.open("a") as file:
                file.write(json.dumps(row | {"measured": stamp()}) + "\n")


if __name__ == "__main__":
    main()
