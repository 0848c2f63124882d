"""All statistics over runs of one filter, from the results of the runs."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from bench.core.mathematics.arrays import FloatArray
from bench.core.mathematics.units import SAME_INSTANT
from bench.core.records.run_records import ErrorSeries
from bench.core.records.run_result import RunResult
from bench.core.records.specs import EvaluationWindow
from bench.evaluation.consistency.chi_square import MeanNis, SensorNis, mean_nis, nis_by_sensor
from bench.evaluation.ensembles import ensemble
from bench.evaluation.ensembles.ensemble import Comparison, Course, Estimate, Growth, Whiteness
from bench.evaluation.ensembles.ensemble_consistency import LEAST_RUNS, Consistency, check_consistency
from bench.evaluation.errors.error_series import BLOCKS, claimed_blocks, estimated_blocks

SIGMAS = 3.0
"""Errors within so many standard deviations count as covered."""
INTERVALS = 20
"""Parts of a run over which NIS is averaged."""
ELAPSED = (1.0, 3.0, 10.0, 30.0, 60.0, 120.0, 300.0, 600.0)
"""Times since the start of an outage after which the growth is taken, besides its end [s]."""


@dataclass(frozen=True, slots=True)
class EnsembleSummary:
    """Statistics of a filter over runs; statistics of errors are over the runs that converged."""

    label: str
    runs: int
    converged: Estimate  # rate of runs [1]
    diverged: Estimate  # with a solution that did not converge
    failed: Estimate  # without a solution
    rmse: Mapping[str, Estimate]  # "pos_h_m", "pos_d_m", "vel_3d_mps", "tilt_deg", "heading_deg"
    cep50_m: Estimate | None  # None without position
    r95_m: Estimate | None
    sep50_m: Estimate | None
    coverage: Mapping[str, Estimate]  # of 3 sigma, by block: "pos", "vel", "phi" [1]
    anees: Course | None  # None if no covariance is reported
    nis: Mapping[str, MeanNis]  # by sensor
    nis_course: Mapping[str, Course]  # along the run, by sensor; NaN where it has no update
    growth: Mapping[str, tuple[Growth, ...]]  # of the horizontal error, by number of the outage
    whiteness: Mapping[tuple[str, int], Whiteness]  # by sensor and component
    consistency: Consistency | None  # None with fewer than 8 runs


def summarize_runs(results: Sequence[RunResult], label: str, evaluation: EvaluationWindow) -> EnsembleSummary:
    """Return the statistics of a filter over runs of one profile with different noise.

    Parameters
    ----------
    results : sequence of RunResult
        At least two runs that converged, with the same output epochs.
    label : str
        The estimator.
    evaluation : EvaluationWindow
        What counts.

    Raises
    ------
    ValueError
        If fewer than two runs converged.
    """
    good = [one for one in results if one.metrics[label]["converged"]]
    if len(good) < 2:
        raise ValueError(f"{label}: {len(good)} of {len(results)} runs converged; at least 2 are needed")
    errors, solutions = [one.errors[label] for one in good], [one.solutions[label] for one in good]
    failed = sum(bool(one.metrics[label].get("failed")) for one in results)
    late = errors[0].t >= evaluation.first
    columns = {"pos": "pos_n", "vel": "vel_n", "phi": "phi_n"}
    blocks = {
        name: np.stack([getattr(one, columns[name])[late] for one in errors])
        for name in estimated_blocks(solutions[0])
    }
    heading = np.stack([one.heading[late] for one in errors])
    claimed = claimed_blocks(solutions[0])
    sd = np.sqrt(np.stack([np.einsum("kii->ki", one.cov[late]) for one in solutions]))
    nis: dict[str, list[SensorNis]] = {}
    white: dict[tuple[str, int], list[FloatArray]] = {}
    for one in solutions:
        table = one.innovations
        for sensor, series in nis_by_sensor(table, evaluation.first).items():
            nis.setdefault(sensor, []).append(series)
            of_sensor = table.component[table.code == table.sensor.index(sensor)]
            for component in np.unique(of_sensor).tolist():
                z = ensemble.normalize_innovations(table, sensor, component, evaluation.first)
                white.setdefault((sensor, component), []).append(z)
    pos = blocks.get("pos")
    edges = np.linspace(evaluation.begin, errors[0].t[-1] + SAME_INSTANT, INTERVALS + 1)
    nees = np.stack([one.nees[late] for one in errors])
    return EnsembleSummary(
        label=label,
        runs=len(results),
        converged=ensemble.estimate_rate(len(good), len(results)),
        diverged=ensemble.estimate_rate(len(results) - len(good) - failed, len(results)),
        failed=ensemble.estimate_rate(failed, len(results)),
        rmse={name: ensemble.pool_rmse(square) for name, square in _list_squares(blocks, heading).items()},
        cep50_m=None if pos is None else ensemble.pool_quantile(_length(pos[..., :2]), 0.50),
        r95_m=None if pos is None else ensemble.pool_quantile(_length(pos[..., :2]), 0.95),
        sep50_m=None if pos is None else ensemble.pool_quantile(_length(pos), 0.50),
        coverage={
            name: ensemble.estimate_fraction(
                (np.abs(blocks[name]) <= SIGMAS * sd[..., BLOCKS[name]]).reshape(len(good), -1)
            )
            for name in claimed
        },
        anees=ensemble.average_nees(errors[0].t[late], nees, errors[0].states) if claimed else None,
        nis={
            name: mean_nis(np.concatenate([s.nis for s in rows]), np.concatenate([s.dof for s in rows]))
            for name, rows in nis.items()
        },
        nis_course={name: ensemble.average_nis(rows, edges) for name, rows in nis.items()},
        growth={} if pos is None else _measure_growth(results[0].profile.get("gnss_outage", ()), errors),
        whiteness={
            key: ensemble.measure_whiteness(rows)
            for key, rows in white.items()
            if sum(map(len, rows)) > 2 * ensemble.LAGS * len(rows)
        },
        consistency=check_consistency(nees, errors[0].states, nis, rows=[one.metrics[label] for one in good])
        if claimed and len(good) >= LEAST_RUNS
        else None,
    )


def _measure_growth(
    rows: Sequence[Mapping[str, float]], errors: Sequence[ErrorSeries]
) -> dict[str, tuple[Growth, ...]]:
    """Return the error growth over each outage that starts at an epoch of the solution, by its number."""
    found, t = {}, errors[0].t
    pos_n = np.stack([one.pos_n for one in errors])
    outages = sorted((row["start_s"], row["duration_s"]) for row in rows)
    for number, (start, duration) in enumerate(outages, 1):
        if t[0] <= start + SAME_INSTANT:
            elapsed = [*(one for one in ELAPSED if one < duration), duration]
            inside = [min(one, duration - 2 * SAME_INSTANT) for one in elapsed]  # at its end GNSS is back
            grown = ensemble.measure_growth(t, pos_n, start + SAME_INSTANT, inside)
            found[str(number)] = tuple(replace(g, elapsed=s) for g, s in zip(grown, elapsed, strict=True))
    return found


def _length(vectors: FloatArray) -> FloatArray:
    return np.asarray(np.linalg.norm(vectors, axis=-1))


def _list_squares(blocks: Mapping[str, FloatArray], heading: FloatArray) -> dict[str, FloatArray]:
    """Return the mean squared error (R,) of each run, keyed by the name of the RMSE."""
    sizes: dict[str, FloatArray] = {}
    if "pos" in blocks:
        sizes |= {"pos_h_m": _length(blocks["pos"][..., :2]), "pos_d_m": blocks["pos"][..., 2]}
    if "vel" in blocks:
        sizes["vel_3d_mps"] = _length(blocks["vel"])
    if "phi" in blocks:
        sizes["tilt_deg"] = np.rad2deg(_length(blocks["phi"][..., :2]))
        sizes["heading_deg"] = np.rad2deg(heading)
    return {name: np.mean(size**2, axis=1) for name, size in sizes.items()}


def compare_estimators(
    results: Sequence[RunResult], labels: tuple[str, str], metric: str = "pos_rmse_h_m", unit: str = "m"
) -> Comparison:
    """Compare an RMSE of two filters on the same runs, over the runs in which both converged."""
    pairs = [
        (a[metric], b[metric])
        for a, b in ((one.metrics[labels[0]], one.metrics[labels[1]]) for one in results)
        if a["converged"] and b["converged"]
    ]
    first, second = np.array(pairs, float).reshape(-1, 2).T
    return ensemble.compare_rmse(labels, first, second, unit)
