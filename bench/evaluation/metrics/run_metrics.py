"""Named scalars of one run, each a function of a :class:`Case` with its row in :data:`METRICS`.

Its name ends in its unit. Each exists twice: ``x`` after the alignment window, ``x_all`` over the whole run.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from functools import cache, partial
from typing import Any, Literal, NamedTuple

import numpy as np

from bench.core.files import disk_arrays
from bench.core.mathematics.arrays import BoolArray, FloatArray
from bench.core.mathematics.units import unit_of
from bench.core.records.data import NavSolution, SensorData, Trajectory
from bench.core.records.run_records import ErrorSeries, OffPath, SensorTruth
from bench.core.records.sensor_specs import AssumedSpecs, Fault
from bench.core.records.specs import EvaluationWindow
from bench.core.words.wording import one_line
from bench.evaluation.errors import total_system
from bench.evaluation.errors.error_series import (
    BLOCKS,
    check_convergence,
    claimed_blocks,
    count_aligning_epochs,
    error_series,
    estimated_blocks,
    find_covered_epochs,
    select_epochs,
)
from bench.evaluation.errors.failures import describe_failure
from bench.evaluation.errors.poses import Poses, lengths
from bench.evaluation.linear import drift_laws
from bench.evaluation.metrics import claims, detection, path_errors
from bench.evaluation.metrics import orientation_errors as attitude
from bench.evaluation.metrics.case import NO_TIMES, Case, Outages, build_case, cut_case
from bench.evaluation.metrics.coverage import (
    Coverage,
    carry_on,
    find_excused,
    find_own_rate,
    find_silent_epochs,
    measure_coverage,
)

Value = float | None
Values = Mapping[str, Value]

Direction = Literal["lower", "matched", "zero", "not evaluated"]
"""How a baseline evaluates a metric: the lower the better; it has a value that is expected; the same with the
value 0, which it also has where it is absent; or not, because it is a fact, a bound, a largest value, or
says what another metric says."""


class Metric(NamedTuple):
    """A row of :data:`METRICS`."""

    name: str  # ends in the unit; ``{}`` stands for each key of a function that returns several values
    function: Callable[[Case], Value | Values]  # the first line of its docstring describes the metric
    block: Literal["pos", "vel", "phi", "cov", "pos cov", "vel cov", "phi cov", ""]  # absent without it
    direction: Direction

    @property
    def unit(self) -> str:
        """Unit of the metric; "1" if it has none."""
        return unit_of(self.name) or "1"

    @property
    def words(self) -> str:
        """Return the description of the metric in one line."""
        return str(getattr(self.function, "func", self.function).__doc__ or "").partition("\n")[0]


# --- accuracy -----------------------------------------------------------------------------------------


def _rms(values: FloatArray) -> float:
    return float(np.sqrt(np.mean(np.square(values))))


def rmse(block: str, case: Case) -> Values:
    """Root mean square of the error of a block [m or m/s]: n, e, d, h (horizontal) and 3d."""
    error_n = getattr(case, f"{block}_n")
    by_axis: dict[str, Value] = {axis: _rms(error_n[:, k]) for k, axis in enumerate(claims.AXES)}
    horizontal = case.pos_h if block == "pos" else _horizontal_norm(error_n)
    return by_axis | {"h": _rms(horizontal), "3d": _rms(lengths(error_n))}


def pos_max_h(case: Case) -> float:
    """Largest horizontal position error [m]."""
    return float(case.pos_h.max())


def pos_max_v(case: Case) -> float:
    """Largest vertical position error [m]."""
    return float(np.abs(case.pos_n[:, 2]).max())


def vel_max(case: Case) -> float:
    """Largest velocity error, 3D [m/s]."""
    return float(lengths(case.vel_n).max())


def _horizontal_norm(error_n: FloatArray) -> FloatArray:
    return np.hypot(error_n[:, 0], error_n[:, 1])


def _order_statistic(values: FloatArray, fraction: float) -> float:
    """Return the order statistic: the smallest value that a fraction of the values does not exceed."""
    return float(np.quantile(values, fraction, method="inverted_cdf"))


def cep(fraction: float, case: Case) -> float:
    """Radius with 50 or 95 % of the horizontal errors [m]; without a solution the error is infinite."""
    return _order_statistic(np.where(case.silent, np.inf, case.pos_h), fraction)


def pos_95_v(case: Case) -> float:
    """Distance that contains 95 % of the vertical errors [m]; without a solution the error is infinite."""
    return _order_statistic(np.where(case.silent, np.inf, np.abs(case.pos_n[:, 2])), 0.95)


# --- rejections and events -------------------------------------------------------------------------------


def refused(case: Case) -> Values:
    """Longest time over which each sensor was rejected without a pause [s], outside its scripted faults."""
    return {name: end - start for name, (start, end) in detection.find_refusals(case).items()}


def events(case: Case) -> Values:
    """Number of events that the filter reported, by kind."""
    return {kind: float(count) for kind, count in case.events.items()}


METRICS: tuple[Metric, ...] = (
    Metric("pos_rmse_{}_m", partial(rmse, "pos"), "pos", "lower"),
    Metric("pos_max_h_m", pos_max_h, "pos", "not evaluated"),
    Metric("pos_max_v_m", pos_max_v, "pos", "not evaluated"),
    Metric("cep50_m", partial(cep, 0.50), "pos", "lower"),
    Metric("cep95_m", partial(cep, 0.95), "pos", "lower"),
    Metric("r95_m", partial(cep, 0.95), "pos", "not evaluated"),
    Metric("pos_95_v_m", pos_95_v, "pos", "lower"),
    *(Metric(f"{p}_{{}}_m", partial(total_system.measure, p), "pos", "lower") for p in total_system.PARTS),
    Metric("vel_rmse_{}_mps", partial(rmse, "vel"), "vel", "lower"),
    Metric("vel_max_mps", vel_max, "vel", "not evaluated"),
    Metric("phi_rmse_{}_deg", attitude.phi_rmse, "phi", "lower"),
    Metric("tilt_rmse_deg", attitude.tilt_rmse, "phi", "lower"),
    Metric("heading_rmse_deg", attitude.heading_rmse, "phi", "lower"),
    Metric("heading_max_deg", attitude.heading_max, "phi", "not evaluated"),
    Metric("total_error_rmse_deg", attitude.total_error_rmse, "phi", "not evaluated"),
    Metric("total_error_max_deg", attitude.total_error_max, "phi", "not evaluated"),
    Metric("inclination_rmse_deg", attitude.inclination_rmse, "phi", "not evaluated"),
    Metric("vertical_part_rmse_deg", attitude.vertical_part_rmse, "phi", "not evaluated"),
    Metric("heading_drift_rmse_deg", attitude.heading_drift_rmse, "phi", "not evaluated"),
    Metric("heading_convergence_s", attitude.heading_convergence, "phi", "lower"),
    Metric("heading_right_s", attitude.heading_right, "phi", "not evaluated"),
    Metric("outage_{}_drift_h_m", drift_laws.outage_drift, "pos", "lower"),
    Metric("outage_{}_growth_h_m", drift_laws.outage_growth, "pos", "lower"),
    Metric("fault_{}_detected", detection.fault_detected, "", "matched"),
    Metric("fault_{}_delay_s", detection.fault_delay, "", "lower"),
    Metric("fault_{}_alarm_share", detection.fault_alarm_share, "", "not evaluated"),
    Metric("fault_{}_max_h_m", detection.fault_max_h, "pos", "lower"),
    Metric("false_alarms_{}", detection.false_alarms, "", "zero"),
    Metric("false_alarm_rate_per_h", detection.false_alarm_rate, "", "not evaluated"),
    Metric("false_alarm_share", detection.false_alarm_share, "", "not evaluated"),
    Metric("nees_mean", claims.nees_mean, "cov", "matched"),
    Metric("nees_states", claims.nees_states, "cov", "not evaluated"),
    Metric("nees_inside_95", claims.nees_inside_95, "cov", "matched"),
    Metric("coverage_3sigma_pos_{}", partial(claims.coverage, 3.0, "pos"), "pos cov", "matched"),
    Metric("coverage_3sigma_vel_{}", partial(claims.coverage, 3.0, "vel"), "vel cov", "matched"),
    Metric("coverage_3sigma_phi_{}", partial(claims.coverage, 3.0, "phi"), "phi cov", "matched"),
    Metric("output_coverage", claims.output_coverage, "", "matched"),
    Metric("availability_{}", claims.answered, "", "not evaluated"),
    Metric("first_answer_s", claims.first_answer, "", "not evaluated"),
    Metric("nis_mean_{}", partial(claims.nis, "mean"), "", "matched"),
    *(Metric(f"nis_{e}_{{}}", partial(claims.nis, e), "", "not evaluated") for e in claims.EDGES),
    Metric("updates_{}", claims.updates, "", "not evaluated"),
    Metric("rejected_{}", claims.rejected, "", "not evaluated"),
    Metric("events_{}", events, "", "not evaluated"),
    Metric("longest_rejection_{}_s", refused, "", "zero"),
    Metric("pos_sigma_h_m", claims.claimed_error_h, "pos cov", "not evaluated"),
    Metric("error_over_sigma_{}", claims.error_over_sigma, "cov", "not evaluated"),
    *(Metric(f"nees_{e}", partial(claims.nees_band, e), "cov", "not evaluated") for e in claims.EDGES),
    Metric("nees_ratio_{}", claims.nees_ratio, "cov", "not evaluated"),
    Metric("log_score_{}", claims.log_score, "cov", "not evaluated"),
    Metric("coverage_1sigma_{}", partial(claims.coverage_within, 1.0), "cov", "not evaluated"),
    Metric("coverage_2sigma_{}", partial(claims.coverage_within, 2.0), "cov", "not evaluated"),
    Metric("nees_samples", claims.nees_samples, "cov", "not evaluated"),
    Metric("coverage_low_pos_{}", partial(claims.coverage_low, "pos"), "pos cov", "not evaluated"),
    Metric("coverage_low_vel_{}", partial(claims.coverage_low, "vel"), "vel cov", "not evaluated"),
    Metric("coverage_low_phi_{}", partial(claims.coverage_low, "phi"), "phi cov", "not evaluated"),
    Metric("gyro_bias_rmse_{}_deg_h", partial(claims.bias_rmse, "gyro_bias"), "", "lower"),
    Metric("accel_bias_rmse_{}_mg", partial(claims.bias_rmse, "accel_bias"), "", "lower"),
    Metric("coverage_3sigma_bias_{}", claims.bias_coverage, "", "matched"),
    Metric("nees_bias_{}", claims.nees_bias, "", "matched"),
    Metric("nees_low_bias_{}", partial(claims.nees_bias_band, "low"), "", "not evaluated"),
    Metric("nees_high_bias_{}", partial(claims.nees_bias_band, "high"), "", "not evaluated"),
    Metric("outage_{}_predicted_h_m", partial(drift_laws.outage_law, "rms"), "phi", "not evaluated"),
    Metric("outage_{}_predicted_95_h_m", partial(drift_laws.outage_law, "95"), "phi", "not evaluated"),
    Metric("inertial_end_h_m", drift_laws.inertial_end, "phi", "lower"),
    Metric("inertial_predicted_{}_h_m", drift_laws.inertial_law, "phi", "not evaluated"),
    Metric("ape_aligned_rmse_m", path_errors.ape_aligned, "pos", "lower"),
    Metric("rpe_{}_m", partial(path_errors.rpe, "m"), "pos", "lower"),
    Metric("rpe_{}_deg", partial(path_errors.rpe, "deg"), "phi", "lower"),
    Metric("drift_{}_percent", path_errors.drift_percent, "pos", "lower"),
    Metric("time_offset_ms", path_errors.time_offset, "vel", "zero"),
)


_LONGEST = 200  # characters of an error in a message
_OF_ANSWERS = ("output_coverage", "availability_{}", "first_answer_s")
"""Metrics that need no epoch with an answer."""

# --- all metrics of a run ----------------------------------------------------------------------------------


def measure(
    truth: Trajectory,
    solution: NavSolution,
    *,
    evaluation: EvaluationWindow,
    outages: Outages,
    faults: Sequence[Fault] = (),
    assumed: AssumedSpecs | None = None,
    drawn: SensorTruth | None = None,
    data: SensorData | None = None,
    path: OffPath | None = None,
) -> tuple[ErrorSeries, dict[str, Any]]:
    """Compare a solution with the truth: return the errors and the metrics of one filter in one run.

    Parameters
    ----------
    truth : Trajectory
        The motion as flown.
    solution : NavSolution
        The output of the estimator. Epochs before the end of the window that are NaN throughout belong to
        its alignment; ``x_all`` begins after them.
    evaluation : EvaluationWindow
        What metrics ``x`` count; ``x_all`` are of the whole run.
    outages : sequence of (start, end)
        Scripted GNSS outages, [start, end) [s], in order.
    faults : sequence of Fault
        Scripted faults, as the profile numbers them.
    assumed : AssumedSpecs or None
        The datasheets to expect drift from.
    drawn : SensorTruth or None
        The true biases.
    data, path : SensorData, OffPath, or None
        What the filter got, which may excuse a silence; the path that it flew off, at all its epochs.

    Returns
    -------
    errors : ErrorSeries
        Estimate minus truth.
    metrics : dict
        ``converged`` (bool), ``reason`` (text, or None when converged), ``failed`` (True, only where
        there is no solution), ``traceback`` (text, only where the filter raised), then a float or None
        by metric name. A metric of a block that is not estimated is absent; one that is not finite, or has
        no value after the alignment window, is None; ``no_value`` says of each that raised why.

    Raises
    ------
    ValueError
        If the solution is empty or has a time outside the truth.
    """
    if len(solution) == 0:
        raise ValueError("NavSolution.t must hold at least one time; got none")
    errors = error_series(truth, solution)
    rows, silent = find_covered_epochs(solution), find_silent_epochs(solution)
    judged, covered = select_epochs(errors, rows), select_epochs(solution, rows)
    carried = None
    if silent.any():
        moved = carry_on(solution, silent)
        carried = CarriedSolution(error_series(truth, moved), moved, silent & ~find_excused(solution, data))
    return errors, judge_epochs(
        judged,
        covered,
        evaluation,
        outages=outages,
        faults=faults,
        missing=solution.t[~rows & ~find_own_rate(solution)[1]],
        assumed=assumed,
        drawn=drawn,
        factored=True,
        carried=carried,
        coverage=measure_coverage(solution, data),
        path=path,
    )


class CarriedSolution(NamedTuple):
    """A solution with its missing epochs extrapolated, and its errors."""

    errors: ErrorSeries
    solution: NavSolution
    silent: BoolArray  # (M,) epochs without an answer that nothing excuses


def judge_epochs(
    errors: ErrorSeries,
    solution: NavSolution,
    evaluation: EvaluationWindow,
    *,
    outages: Outages = (),
    faults: Sequence[Fault] = (),
    missing: FloatArray = NO_TIMES,
    assumed: AssumedSpecs | None = None,
    drawn: SensorTruth | None = None,
    factored: bool = False,
    metrics: Sequence[Metric] = METRICS,
    carried: CarriedSolution | None = None,
    coverage: Coverage | None = None,
    path: OffPath | None = None,
) -> dict[str, Any]:
    """Return the metrics of errors and a solution at the same epochs, as :func:`judge` does.

    ``missing`` holds the epochs (K,) that were asked for and have no solution [s]; ``metrics`` are the rows
    of :data:`METRICS` to compute. ``factored`` is that of :func:`check_convergence`. Metrics of accuracy are
    of ``carried``, if it is given, and so hold silent epochs.
    """
    aligned = slice(count_aligning_epochs(solution, evaluation.begin), None)
    errors, solution = select_epochs(errors, aligned), select_epochs(solution, aligned)
    sound, reason = check_convergence(errors, solution, factored=factored)
    late = count_aligning_epochs(solution, np.inf)
    if late:
        first = solution.t[late]
        sound, reason = False, f"no solution before t = {first:g} s; metrics begin at {evaluation.begin:g} s"
    with np.errstate(all="ignore"):  # NaN and overflow are allowed in a run that did not converge
        poses = Poses.from_errors(solution, errors)
        run = build_case(
            errors, solution, outages, faults, missing, assumed, drawn, poses, coverage=coverage, path=path
        )
        every = run
        if carried is not None:
            off, moved = carried.errors, carried.solution
            poses = Poses.from_errors(moved, off)
            every = build_case(
                off, moved, outages, faults, assumed=assumed, poses=poses, silent=carried.silent, path=path
            )
        problems: dict[str, str] = {}
        whole = _compute_metrics(run, every, solution, metrics, problems)
        window = _compute_metrics(
            cut_case(run, evaluation, missing), cut_case(every, evaluation), solution, metrics, problems
        )
    lost = detection.find_lost_aiding(run)
    if sound and lost is not None:
        sound, reason = False, lost
    values: dict[str, Any] = {"converged": sound, "reason": reason, **describe_failure(solution)}
    values.update({name: window.get(name) for name in whole})
    values.update({f"{name}_all": value for name, value in whole.items()})
    return {**values, "no_value": problems} if problems else values


def _compute_metrics(
    case: Case, every: Case, solution: NavSolution, metrics: Sequence[Metric], problems: dict[str, str]
) -> dict[str, Value]:
    """Compute the metrics of the estimated blocks; a value that is not finite becomes None.

    Those of accuracy are of ``every`` epoch, the others of those of ``case``. One that raises has no value;
    ``problems`` says why.
    """
    if not len(every.t):
        return {}
    claimed = claimed_blocks(solution)
    blocks = ("", *estimated_blocks(solution), *(f"{name} cov" for name in claimed), *["cov"][: len(claimed)])
    values: dict[str, Value] = {}
    for metric in metrics:
        if metric.block in blocks and (len(case.t) or metric.block in BLOCKS or metric.name in _OF_ANSWERS):
            try:
                result = metric.function(every if metric.block in BLOCKS else case)
            except Exception as error:  # the others have theirs
                problems[metric.name] = one_line(f"{type(error).__name__}: {error}")[:_LONGEST]
                continue
            named = result if isinstance(result, Mapping) else {"": result}
            values.update({metric.name.format(key): value for key, value in named.items()})
            if len(case.t) > disk_arrays.LONG * disk_arrays.ROWS:
                disk_arrays.release()
    return {name: float(v) if v is not None and np.isfinite(v) else None for name, v in values.items()}


@cache
def find_metric(name: str) -> Metric | None:
    """Return the row of :data:`METRICS` for the name of a metric, with or without ``_all``; None if unknown.

    Examples
    --------
    >>> find_metric("outage_2_drift_h_m_all").unit
    'm'
    """
    name = name.removesuffix("_all")
    for metric in METRICS:
        head, gap, tail = metric.name.partition("{}")
        if name == metric.name or (gap and name.startswith(head) and name.endswith(tail, len(head) + 1)):
            return metric
    return None
