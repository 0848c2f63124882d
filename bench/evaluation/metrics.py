"""Named scalars of one run, each a function of a :class:`Case` with its row in :data:`METRICS`.

A metric's name ends in its unit. Every metric exists twice: ``x`` over the epochs
from the end of the alignment window on, ``x_all`` over the whole run.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any, Literal

import numpy as np

from bench.arrays import FloatArray
from bench.data import ErrorSeries, NavSolution, Trajectory
from bench.evaluation import detection
from bench.evaluation.consistency import SensorNis, chi2_quantile, mean_nis, nis_by_sensor
from bench.evaluation.error_series import (
    BLOCKS,
    aligning,
    at_rows,
    claimed_blocks,
    converged,
    covered,
    error_series,
    estimated_blocks,
    from_row,
    heading_sd,
)
from bench.specs import Fault
from bench.units import SAME_INSTANT

Outages = Sequence[tuple[float, float]]
Value = float | None
Values = Mapping[str, Value]

AXES = ("n", "e", "d")

HEADING_LIMIT = np.deg2rad(1.0)
"""A heading has converged below the larger of this and 3 sigma [rad]."""

_NOTHING = np.empty(0)


@dataclass(frozen=True, slots=True)
class Case:
    """What a metric sees: the epochs of one run from an instant on."""

    t: FloatArray  # (M,) [s]
    pos_n: FloatArray  # (M, 3) errors [m], n
    vel_n: FloatArray  # (M, 3) [m/s], n
    phi_n: FloatArray  # (M, 3) [rad], n
    heading: FloatArray  # (M,) [rad]
    heading_sd: FloatArray  # (M,) [rad]
    sd: FloatArray  # (M, 9) of pos_n, vel_n, phi_n
    nees: FloatArray  # (M,)
    states: int  # that nees counts
    nis: Mapping[str, SensorNis]
    events: Mapping[str, int]  # what the estimator reported: number by kind
    outages: tuple[tuple[int, float, float], ...]  # number from 1, [start, end) [s]: those that start inside
    faults: Mapping[str, Fault]  # number from 1: those that start inside
    scripted: tuple[Fault, ...]  # all of the run
    alarms: tuple[detection.Alarms, ...]  # of the whole run
    from_s: float  # [s]
    asked: int  # number of epochs asked for, of which t holds those that the solution covers


@dataclass(frozen=True, slots=True)
class Metric:
    """A row of :data:`METRICS`."""

    name: str  # ends in the unit; ``{}`` stands for each key of a function that returns several values
    function: Callable[[Case], Value | Values]
    unit: str
    block: Literal["pos", "vel", "phi", "cov", "pos cov", "vel cov", "phi cov", ""]  # absent without it
    direction: Literal["lower", "both", ""]  # what a baseline holds: lower is better, no drift, nothing
    description: str


# --- accuracy -----------------------------------------------------------------------------------------


def _rms(values: FloatArray) -> float:
    return float(np.sqrt(np.mean(np.square(values))))


def _axis_rms(error_n: FloatArray) -> dict[str, Value]:
    by_axis: dict[str, Value] = {axis: _rms(error_n[:, k]) for k, axis in enumerate(AXES)}
    squares = np.square(error_n)
    by_axis["h"] = float(np.sqrt(squares[:, :2].sum(axis=1).mean()))
    by_axis["3d"] = float(np.sqrt(squares.sum(axis=1).mean()))
    return by_axis


def pos_rmse(case: Case) -> Values:
    """Root mean square of the position error by axis, horizontal and 3D [m]."""
    return _axis_rms(case.pos_n)


def vel_rmse(case: Case) -> Values:
    """Root mean square of the velocity error by axis, horizontal and 3D [m/s]."""
    return _axis_rms(case.vel_n)


def phi_rmse(case: Case) -> Values:
    """Root mean square of the attitude error by axis of n [deg]."""
    return {axis: float(np.rad2deg(_rms(case.phi_n[:, k]))) for k, axis in enumerate(AXES)}


def tilt_rmse(case: Case) -> float:
    """Root mean square of the angle between true and estimated vertical, first order [deg]."""
    return float(np.rad2deg(_rms(_norm_h(case.phi_n))))


def heading_rmse(case: Case) -> float:
    """Root mean square of the heading error [deg]."""
    return float(np.rad2deg(_rms(case.heading)))


def heading_max(case: Case) -> float:
    """Largest heading error [deg]."""
    return float(np.rad2deg(np.abs(case.heading).max()))


def pos_max_h(case: Case) -> float:
    """Largest horizontal position error [m]."""
    return float(_norm_h(case.pos_n).max())


def pos_max_v(case: Case) -> float:
    """Largest vertical position error [m]."""
    return float(np.abs(case.pos_n[:, 2]).max())


def vel_max(case: Case) -> float:
    """Largest velocity error, 3D [m/s]."""
    return float(np.linalg.norm(case.vel_n, axis=1).max())


def _norm_h(error_n: FloatArray) -> FloatArray:
    return np.hypot(error_n[:, 0], error_n[:, 1])


def _order(values: FloatArray, fraction: float) -> float:
    """Return the smallest of the values that at least a fraction of them does not exceed."""
    return float(np.quantile(values, fraction, method="inverted_cdf"))


def cep50(case: Case) -> float:
    """Radius that holds half of the horizontal errors [m]."""
    return _order(_norm_h(case.pos_n), 0.50)


def cep95(case: Case) -> float:
    """Radius that holds 95 % of the horizontal errors [m]: CEP95, and R95, which is its other name."""
    return _order(_norm_h(case.pos_n), 0.95)


def pos_95_v(case: Case) -> float:
    """Vertical distance that holds 95 % of the vertical errors [m]."""
    return _order(np.abs(case.pos_n[:, 2]), 0.95)


# --- outages and convergence --------------------------------------------------------------------------


def _outage_rows(case: Case) -> dict[str, tuple[int, int]]:
    """Return the first and last row of each outage that has a row; an interval is [start, end)."""
    rows = {}
    for number, start, end in case.outages:
        first = int(np.searchsorted(case.t, start - SAME_INSTANT))
        last = int(np.searchsorted(case.t, end - SAME_INSTANT)) - 1
        if first <= last:
            rows[str(number)] = first, last
    return rows


def outage_drift_h(case: Case) -> Values:
    """Horizontal error at the last instant of each outage [m]."""
    return {key: float(np.hypot(*case.pos_n[last, :2])) for key, (_, last) in _outage_rows(case).items()}


def outage_growth_h(case: Case) -> Values:
    """Length of horizontal error at the last minus error at the first instant of each outage [m]."""
    return {
        key: float(np.hypot(*(case.pos_n[last, :2] - case.pos_n[first, :2])))
        for key, (first, last) in _outage_rows(case).items()
    }


def heading_convergence(case: Case) -> Value:
    """Return the time [s] after which the heading error stays below max(1 deg, 3 sigma).

    It stays there to the end of the run or the start of the next outage. The first
    such instant, since the start of the run; None when there is none.
    """
    below = np.abs(case.heading) < np.fmax(HEADING_LIMIT, 3.0 * case.heading_sd)
    starts = [int(np.searchsorted(case.t, start - SAME_INSTANT)) for _, start, _ in case.outages]
    edges = sorted({0, *starts, len(case.t)})
    for first, end in pairwise(edges):
        above = np.flatnonzero(~below[first:end])
        settled = first + (int(above[-1]) + 1 if len(above) else 0)
        if settled < end:
            return float(case.t[settled])
    return None


# --- consistency --------------------------------------------------------------------------------------


def nees_mean(case: Case) -> float:
    """Mean NEES; its expectation is nees_states. One run has no band: its errors are correlated in time."""
    return float(np.mean(case.nees))


def nees_states(case: Case) -> float:
    """Number of states that NEES counts."""
    return float(case.states)


def nees_inside_95(case: Case) -> float:
    """Fraction of epochs whose NEES lies in the central 95 % of its chi-square distribution."""
    low, high = chi2_quantile(0.025, case.states), chi2_quantile(0.975, case.states)
    return float(np.mean((low <= case.nees) & (case.nees <= high)))


def _coverage(error_n: FloatArray, sd: FloatArray) -> Values:
    inside = np.abs(error_n) <= 3.0 * sd
    return {axis: float(np.mean(inside[:, k])) for k, axis in enumerate(AXES)}


def coverage_pos(case: Case) -> Values:
    """Fraction of epochs with the position error within 3 sigma, by axis; 0.9973 is right."""
    return _coverage(case.pos_n, case.sd[:, BLOCKS["pos"]])


def coverage_vel(case: Case) -> Values:
    """Fraction of epochs with the velocity error within 3 sigma, by axis; 0.9973 is right."""
    return _coverage(case.vel_n, case.sd[:, BLOCKS["vel"]])


def coverage_phi(case: Case) -> Values:
    """Fraction of epochs with the attitude error within 3 sigma, by axis of n; 0.9973 is right."""
    return _coverage(case.phi_n, case.sd[:, BLOCKS["phi"]])


def output_coverage(case: Case) -> float:
    """Fraction of the epochs asked for at which there is a solution; metrics are of these."""
    return len(case.t) / case.asked


def nis_mean(case: Case) -> Values:
    """Mean NIS of each sensor, rejected updates included."""
    return {name: mean_nis(s.nis, s.dof).mean for name, s in case.nis.items()}


def nis_low(case: Case) -> Values:
    """Lower edge of the 99.9 % band of nis_mean."""
    return {name: mean_nis(s.nis, s.dof).low for name, s in case.nis.items()}


def nis_high(case: Case) -> Values:
    """Upper edge of the 99.9 % band of nis_mean."""
    return {name: mean_nis(s.nis, s.dof).high for name, s in case.nis.items()}


def updates(case: Case) -> Values:
    """Number of updates of each sensor that were offered."""
    return {name: float(len(s.nis)) for name, s in case.nis.items()}


def rejected(case: Case) -> Values:
    """Number of updates of each sensor of which the gate refused some component."""
    return {name: float(np.sum(~s.accepted)) for name, s in case.nis.items()}


def events(case: Case) -> Values:
    """Number of events of each kind the estimator reported."""
    return {kind: float(count) for kind, count in case.events.items()}


METRICS: tuple[Metric, ...] = (
    Metric("pos_rmse_{}_m", pos_rmse, "m", "pos", "lower", "RMS position error: n, e, d, horizontal, 3D"),
    Metric("pos_max_h_m", pos_max_h, "m", "pos", "", "largest horizontal position error"),
    Metric("pos_max_v_m", pos_max_v, "m", "pos", "", "largest vertical position error"),
    Metric("cep50_m", cep50, "m", "pos", "lower", "radius that holds 50 % of the horizontal errors"),
    Metric("cep95_m", cep95, "m", "pos", "lower", "radius that holds 95 % of the horizontal errors"),
    Metric("r95_m", cep95, "m", "pos", "", "the same as cep95_m, under the name of navigation standards"),
    Metric("pos_95_v_m", pos_95_v, "m", "pos", "lower", "holds 95 % of the vertical errors"),
    Metric("vel_rmse_{}_mps", vel_rmse, "m/s", "vel", "lower", "RMS velocity error: n, e, d, horizontal, 3D"),
    Metric("vel_max_mps", vel_max, "m/s", "vel", "", "largest velocity error, 3D"),
    Metric("phi_rmse_{}_deg", phi_rmse, "deg", "phi", "lower", "RMS attitude error about n, e, d"),
    Metric("tilt_rmse_deg", tilt_rmse, "deg", "phi", "lower", "RMS error of the vertical"),
    Metric("heading_rmse_deg", heading_rmse, "deg", "phi", "lower", "RMS heading error"),
    Metric("heading_max_deg", heading_max, "deg", "phi", "", "largest heading error"),
    Metric(
        "heading_convergence_s",
        heading_convergence,
        "s",
        "phi",
        "",
        "after it |heading error| < max(1 deg, 3 sigma) to the end or the next outage",
    ),
    Metric(
        "outage_{}_drift_h_m", outage_drift_h, "m", "pos", "lower", "horizontal error at its last instant"
    ),
    Metric("outage_{}_growth_h_m", outage_growth_h, "m", "pos", "lower", "last minus first horizontal error"),
    Metric(
        "fault_{}_detected", detection.fault_detected, "1", "", "both", "1: an alarm came while it was there"
    ),
    Metric("fault_{}_delay_s", detection.fault_delay, "s", "", "lower", "from its start to its first alarm"),
    Metric(
        "fault_{}_max_h_m", detection.fault_max_h, "m", "pos", "lower", "largest horizontal error meanwhile"
    ),
    Metric(
        "false_alarms_{}", detection.false_alarms, "1", "", "", "alarms of a sensor that no fault explains"
    ),
    Metric("nees_mean", nees_mean, "1", "cov", "both", "mean NEES; nees_states is expected"),
    Metric("nees_states", nees_states, "1", "cov", "", "states that NEES counts"),
    Metric("nees_inside_95", nees_inside_95, "1", "cov", "both", "epochs in the 95 % interval of NEES"),
    Metric("coverage_3sigma_pos_{}", coverage_pos, "1", "pos cov", "both", "epochs within 3 sigma"),
    Metric("coverage_3sigma_vel_{}", coverage_vel, "1", "vel cov", "both", "epochs within 3 sigma"),
    Metric("coverage_3sigma_phi_{}", coverage_phi, "1", "phi cov", "both", "epochs within 3 sigma"),
    Metric("output_coverage", output_coverage, "1", "", "", "epochs with a solution; metrics are of these"),
    Metric("nis_mean_{}", nis_mean, "1", "", "both", "mean NIS of a sensor, rejected updates included"),
    Metric("nis_low_{}", nis_low, "1", "", "", "lower edge of the 99.9 % band of nis_mean"),
    Metric("nis_high_{}", nis_high, "1", "", "", "upper edge of the 99.9 % band of nis_mean"),
    Metric("updates_{}", updates, "1", "", "", "updates of a sensor offered"),
    Metric("rejected_{}", rejected, "1", "", "", "updates of a sensor refused by the gate"),
    Metric("events_{}", events, "1", "", "", "events of a kind the estimator reported"),
)


# --- the judgement ------------------------------------------------------------------------------------


def judge(
    truth: Trajectory,
    solution: NavSolution,
    *,
    evaluation_from: float,
    outages: Outages,
    faults: Sequence[Fault] = (),
) -> tuple[ErrorSeries, dict[str, Any]]:
    """Return the errors and the metrics of one estimator in one run.

    Parameters
    ----------
    truth : Trajectory
        The motion as flown.
    solution : NavSolution
        What the estimator made of the sensors. Epochs before the end of the window at which it says nothing
        at all, NaN throughout, are those of its alignment; ``x_all`` begins after them.
    evaluation_from : float
        End of the alignment window [s]; metrics ``x`` begin here, ``x_all`` at the start.
    outages : sequence of (start, end)
        Scripted GNSS outages, [start, end) [s], in order.
    faults : sequence of Fault
        Scripted faults, as the profile numbers them.

    Returns
    -------
    errors : ErrorSeries
        Estimate minus truth.
    metrics : dict
        ``converged`` (bool), ``reason`` (text, or None when converged), then a float or None by
        metric name. A metric of a block that is not estimated is absent; all are None when not
        converged, ``x`` also when it has no value after the alignment window.

    Raises
    ------
    ValueError
        When the solution is empty or has a time outside the truth.
    """
    if len(solution) == 0:
        raise ValueError("NavSolution.t must hold at least one instant; got none")
    errors = error_series(truth, solution)
    rows = covered(solution)
    judged, missing, solution = at_rows(errors, rows), solution.t[~rows], at_rows(solution, rows)
    begun = aligning(solution, evaluation_from)
    judged, solution = from_row(judged, begun), from_row(solution, begun)
    sound, reason = converged(judged, solution)
    if aligning(solution, np.inf):
        first = solution.t[aligning(solution, np.inf)]
        sound, reason = False, f"no solution before t = {first:g} s; metrics begin at {evaluation_from:g} s"
    with np.errstate(all="ignore"):  # NaN and overflow are allowed in a run that did not converge
        whole = _values(case_from(judged, solution, -np.inf, outages, faults, missing), solution)
        after = case_from(judged, solution, evaluation_from, outages, faults, missing)
        window = _values(after, solution) if len(after.t) else {}
    metrics: dict[str, Any] = {"converged": sound, "reason": reason}
    metrics.update({name: window.get(name) if sound else None for name in whole})
    metrics.update({f"{name}_all": whole[name] if sound else None for name in whole})
    return errors, metrics


def case_from(
    errors: ErrorSeries,
    solution: NavSolution,
    from_s: float,
    outages: Outages,
    faults: Sequence[Fault] = (),
    missing: FloatArray = _NOTHING,
) -> Case:
    """Return what the metrics see of a run from an instant [s] on; ``missing`` are instants not covered."""
    rows = errors.t >= from_s - SAME_INSTANT
    kinds = [kind for kind, t in zip(solution.events.kind, solution.events.t, strict=True) if t >= from_s]
    with np.errstate(invalid="ignore"):
        sd = np.sqrt(np.einsum("kii->ki", solution.cov))
    return Case(
        t=errors.t[rows],
        pos_n=errors.pos_n[rows],
        vel_n=errors.vel_n[rows],
        phi_n=errors.phi_n[rows],
        heading=errors.heading[rows],
        heading_sd=heading_sd(solution)[rows],
        sd=sd[rows],
        nees=errors.nees[rows],
        states=errors.states,
        nis=nis_by_sensor(solution.innovations, from_s - SAME_INSTANT),
        events={kind: kinds.count(kind) for kind in sorted(set(kinds))},
        outages=tuple(
            (k, start, end)
            for k, (start, end) in enumerate(outages, 1)
            if start >= from_s - SAME_INSTANT and not ((missing >= start) & (missing < end)).any()
        ),
        faults={str(k): f for k, f in enumerate(faults, 1) if f.start >= from_s - SAME_INSTANT},
        scripted=tuple(faults),
        alarms=detection.alarms(nis_by_sensor(solution.innovations), solution.events) if faults else (),
        from_s=from_s,
        asked=int(rows.sum() + np.sum(missing >= from_s - SAME_INSTANT)),
    )


def _values(case: Case, solution: NavSolution) -> dict[str, Value]:
    """Return every metric of the blocks that are estimated; None for one that is not a finite number."""
    claimed = claimed_blocks(solution)
    blocks = ("", *estimated_blocks(solution), *(f"{name} cov" for name in claimed), *["cov"][: len(claimed)])
    values: dict[str, Value] = {}
    for metric in METRICS:
        if metric.block in blocks:
            result = metric.function(case)
            if isinstance(result, Mapping):
                values.update({metric.name.format(key): value for key, value in result.items()})
            else:
                values[metric.name] = result
    return {
        name: value if value is not None and np.isfinite(value) else None for name, value in values.items()
    }


def metric_of(name: str) -> Metric | None:
    """Return the row of :data:`METRICS` a metric's name belongs to; the suffix ``_all`` is allowed.

    Examples
    --------
    >>> metric_of("outage_2_drift_h_m_all").unit
    'm'
    """
    name = name.removesuffix("_all")
    for metric in METRICS:
        head, _, tail = metric.name.partition("{}")
        if name == metric.name or (
            "{}" in metric.name
            and name.startswith(head)
            and name.endswith(tail)
            and len(name) > len(head) + len(tail)
        ):
            return metric
    return None
