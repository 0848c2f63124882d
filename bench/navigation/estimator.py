"""The Estimator protocol: the interface of every filter, and a check that users can run."""

from __future__ import annotations

import inspect
import pickle
import traceback
from collections.abc import Callable, Collection, Hashable, Iterator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import fields, replace
from itertools import pairwise
from typing import Any, Protocol

import numpy as np

from bench.core.records.data import InitialState, NavSolution, SensorData
from bench.core.records.instruments import INSTRUMENTS
from bench.core.records.sensor_specs import AssumedSpecs
from bench.core.words.exceptions import EstimatorError, EstimatorFailedError
from bench.core.words.wording import one_line, suggest
from bench.navigation.answer_check import check_solution


class Estimator(Protocol):
    """Interface of a filter: one sensor record in, one navigation solution out.

    Options are keyword arguments of ``__init__``, which checks them. ``run`` takes data only, keeps nothing
    between calls and never gets the truth. Optional members:

    - ``unmodeled_errors(specs: AssumedSpecs) -> tuple[str, ...]``: sensor errors without a state in the
      filter.
    - ``needs: tuple[str, ...]``: records of `SensorData` that the filter requires (`RECORDS`).
    - ``check_sensors(specs: AssumedSpecs) -> str``: why the filter cannot be consistent with these sensors,
      or "".

    Examples
    --------
    >>> import bench
    >>> class Still:
    ...     def run(self, sensors, initial):
    ...         state = (initial.lla * 0.0).repeat(2), initial.cov[:6, :6]
    ...         return bench.track_solution(sensors, initial, [state] * len(sensors.output_t))
    >>> still: bench.Estimator = Still()
    >>> sensed = bench.sense("approach", bench.fly("approach"))
    >>> still.run(sensed.data, sensed.initial).cov.shape[1:]
    (9, 9)
    """

    def run(self, sensors: SensorData, initial: InitialState) -> NavSolution:
        """Estimate position, velocity, attitude and their covariance at ``sensors.output_t``.

        Where ``initial.alignment`` is not "given", `alignment.complete` finds the rest.

        Raises
        ------
        ValueError
            If no datasheet of a sensor in use is assumed.
        EstimatorError
            If the record does not allow the alignment asked for.
        """
        ...


RECORDS: Mapping[str, str] = {
    "fixes": "a gnss",
    "observations": "a gnss at measurement level, one with [sky] such as 'sky-l1'",
    **{name: row.with_article for name, row in INSTRUMENTS.items()},
}
"""Record of `SensorData` that a filter may need -> the sensor that gives it."""


@contextmanager
def catch_exit(name: str, part: str) -> Iterator[None]:
    """Raise EstimatorFailedError if a filter raises SystemExit or the like, which would end bench.

    KeyboardInterrupt is the user's own.
    """
    try:
        yield
    except (Exception, KeyboardInterrupt):
        raise
    except BaseException as error:
        raise make_failure(name, part, error) from error


def make_failure(name: str, part: str, error: BaseException) -> EstimatorFailedError:
    """Return the error for an exception in a part of a filter."""
    what = one_line("".join(traceback.format_exception_only(error)).strip()[:_LONGEST])
    return EstimatorFailedError(f"filter {name!r}: {part} raised {what}")


_LONGEST = 500  # characters of an exception in a message
_ENDS = (0.3, 0.31, 0.8)  # of pieces, as parts of the samples


def construct(use: str, factory: Callable[..., Estimator], options: Mapping[str, Any]) -> Estimator:
    """Build a filter from its keyword arguments.

    Raises
    ------
    EstimatorError
        If it has no such option or rejects one.
    """
    known = inspect.signature(factory).parameters
    open_ended = any(p.kind is p.VAR_KEYWORD for p in known.values())
    unknown = sorted(set(options) - set(known))
    if unknown and not open_ended:
        what = f"filter {use!r}: unknown option"
        raise EstimatorError(*(f"{what} {name!r}{suggest(name, known, 'options')}" for name in unknown))
    try:
        with catch_exit(use, "its constructor"):
            return factory(**options)
    except (ValueError, TypeError) as error:
        raise EstimatorError(f"filter {use!r}: {error}") from error


def check_needs(
    estimator: Estimator, name: str, records: Collection[str], place: str = "[sensors]", *,
    specs: AssumedSpecs | None = None,
) -> None:  # fmt: skip
    """Check before the flight that a filter gets the records it needs and supports the sensors.

    ``records`` are the names of those there will be; ``place`` is where messages say they come from.

    Raises
    ------
    EstimatorError
        If one of its ``needs`` is missing or is not the name of a record, or if it rejects ``specs``.
    EstimatorFailedError
        If its ``check_sensors`` raises.
    """
    if specs is not None and (said := ask_refusal(estimator, name, specs)):
        raise EstimatorError(f"filter {name!r}: {said}")
    for need in getattr(estimator, "needs", ()):
        if need not in RECORDS:
            raise EstimatorError(f"filter {name!r}: needs {need!r}, expected one of {', '.join(RECORDS)}")
        if need not in records:
            raise EstimatorError(f"filter {name!r} needs {RECORDS[need]}; there is none in {place}")


def ask_refusal(estimator: Estimator, name: str, specs: AssumedSpecs) -> str:
    """Return the reason why a filter rejects sensors with these datasheets; "" if it supports them.

    Raises
    ------
    EstimatorFailedError
        If its ``check_sensors`` raises.
    """
    refuse = getattr(estimator, "check_sensors", None)
    if refuse is None:
        return ""
    try:
        return one_line(str(refuse(specs) or ""))
    except (KeyboardInterrupt, EstimatorFailedError):  # of the user; of a filter in a process of its own
        raise
    except BaseException as error:
        raise make_failure(name, "check_sensors()", error) from error


def find_same(built: Mapping[str, Estimator], sensors: SensorData) -> dict[str, str]:
    """Return the labels of filters that equal an earlier filter on this record, with the earlier label.

    Those that can tell have a method ``identity(sensors) -> Hashable``: of two with the same identity the
    solutions are the same.
    """
    first: dict[Hashable, str] = {}
    same = {}
    for label, one in built.items():
        with suppress(Exception):  # a class of others that cannot tell is the same as none
            same[label] = first.setdefault(one.identity(sensors), label)  # type: ignore[attr-defined]
    return {label: found for label, found in same.items() if found != label}


def answer(estimator: Estimator, name: str, sensors: SensorData, initial: InitialState) -> NavSolution:
    """Return the solution of a filter, checked to be one at every time of ``sensors.output_t``.

    Raises
    ------
    EstimatorError
        If the record does not allow the alignment asked for.
    EstimatorFailedError
        If ``run`` raises or returns something else.
    """
    try:
        solution = estimator.run(sensors, initial)
    except EstimatorError as error:  # from the initial alignment
        raise EstimatorError(f"filter {name!r}: {error}") from error
    except (KeyboardInterrupt, EstimatorFailedError):  # of the user; of a filter in a process of its own
        raise
    except BaseException as error:  # sys.exit() of a filter does not end bench
        raise make_failure(name, "run()", error) from error
    solution = accept(name, solution)
    if not np.array_equal(solution.t, sensors.output_t):
        raise EstimatorFailedError(
            f"filter {name!r}: its t must be sensors.output_t, {len(sensors.output_t)} epochs; "
            f"got {len(solution.t)} epochs" + (", others" if len(solution.t) == len(sensors.output_t) else "")
        )
    return solution


def accept(name: str, found: object) -> NavSolution:
    """Return the solution of a filter, checked by `answer_check.check_solution`.

    Raises
    ------
    EstimatorFailedError
        If it is no solution.
    """
    try:
        return check_solution(found)
    except ValueError as error:
        raise EstimatorFailedError(f"filter {name!r}: {error}") from None


def list_unmodeled(estimator: Estimator, name: str, specs: AssumedSpecs) -> list[str] | None:
    """Return the sensor errors that a filter reports as unmodeled; None if it does not report them.

    Raises
    ------
    EstimatorFailedError
        If its ``unmodeled_errors`` raises.
    """
    list_errors = getattr(estimator, "unmodeled_errors", None)
    if list_errors is None:
        return None
    try:
        return [one_line(str(error)) for error in list_errors(specs)]
    except (KeyboardInterrupt, EstimatorFailedError):  # of the user; of a filter in a process of its own
        raise
    except BaseException as error:
        raise make_failure(name, "unmodeled_errors()", error) from error


def check_estimator(estimator: Estimator, sensors: SensorData, initial: InitialState) -> None:
    """Check that a filter fulfills the requirements of bench.

    The filter must pickle, be repeatable and leave its input unchanged. It must return finite values at every
    output time, with a covariance that is symmetric and positive definite over the blocks it estimates. A
    block it does not estimate is NaN at every time, and every block is NaN before the end of an initial
    alignment. If the initial state is given, it must also accept a record without output times, aiding
    records without rows, and rows that are not finite. A filter that runs in pieces must return the same
    bits.

    Parameters
    ----------
    estimator : Estimator
        Filter to check.
    sensors : SensorData
        Record to run it on.
    initial : InitialState
        Initial state.

    Raises
    ------
    AssertionError
        If a requirement is broken.

    Examples
    --------
    >>> import bench
    >>> from bench.navigation.built_in import load
    >>> sensed = bench.sense("approach", bench.fly("approach"))
    >>> bench.check_estimator(load("loose-15", {}), sensed.data, sensed.initial)
    """
    before = pickle.dumps((sensors, initial))
    try:
        copy = pickle.loads(pickle.dumps(estimator))
    except Exception as error:
        raise AssertionError(f"the filter does not pickle: {error}") from error
    first = copy.run(sensors, initial)
    second = estimator.run(sensors, initial)
    third = estimator.run(sensors, initial)
    assert pickle.dumps((sensors, initial)) == before, "run() changed its input"
    for name in ("lla", "vel_n", "q_nb", "cov"):
        for other, how in ((second, "a pickled copy"), (third, "an earlier call")):
            same = np.array_equal(getattr(first, name), getattr(other, name), equal_nan=True)
            assert same, f"run() is not repeatable: {name} differs from {how}"
    _sound(first, sensors, initial)
    if initial.alignment == "given":
        _check_pieces(estimator, sensors, initial, first)
        for what, hard in _hardships(sensors).items():
            try:
                _sound(estimator.run(hard, initial), hard, initial)
            except Exception as error:
                raise AssertionError(f"{what}: {error!r}") from error


def _check_pieces(estimator: object, sensors: SensorData, initial: InitialState, whole: NavSolution) -> None:
    """Raise AssertionError if the answers of a filter in pieces differ from those on the whole record.

    The start is given.
    """
    from bench.navigation.engine.piecewise import RunsInPieces
    from bench.navigation.engine.record_cuts import longest_wait, slice_sensors, take_head

    if not isinstance(estimator, RunsInPieces):
        return
    wait, head = longest_wait(sensors), take_head(sensors)
    filter_ = estimator.in_pieces(head, initial, [])
    found = []
    for begin, end in pairwise([-np.inf, *np.nanquantile(sensors.imu.t, _ENDS), np.inf]):
        found.append(filter_.update(slice_sensors(sensors, begin, end), wait, last=end == np.inf))
        if end < np.inf:
            filter_.copy().current(head)
    for name in ("t", "lla", "vel_n", "q_nb", "cov"):
        joined = np.concatenate([getattr(one, name) for one in found])
        same = np.array_equal(joined, getattr(whole, name), equal_nan=True)
        assert same, f"in pieces it gives other bits: {name} differs"


def _hardships(sensors: SensorData) -> dict[str, SensorData]:
    """Return damaged records that a filter has to cope with, by the kind of damage."""
    aiding = ({} if sensors.fixes is None else {"fixes": sensors.fixes}) | sensors.instruments
    columns = {
        name: {f.name: np.array(getattr(record, f.name)) for f in fields(record)}
        for name, record in aiding.items()
    }
    empty = {name: type(aiding[name])(**{k: c[:0] for k, c in columns[name].items()}) for name in aiding}
    for by_name in columns.values():
        for key, column in by_name.items():
            if column.dtype == np.float64 and not key.startswith("t"):
                column[::3] = np.nan
        by_name["valid"][::6] = False
    broken = {name: type(aiding[name])(**columns[name]) for name in aiding}
    imu = {f.name: np.array(getattr(sensors.imu, f.name)) for f in fields(sensors.imu)}
    imu["dvel_b"][10::50], imu["dtheta_b"][20::50] = np.nan, np.inf
    return {
        "with no output times": replace(sensors, output_t=sensors.output_t[:0]),
        "with aiding records that have no rows": replace(sensors, **empty),
        "with rows that are not finite": replace(sensors, imu=type(sensors.imu)(**imu), **broken),
    }


def _sound(first: NavSolution, sensors: SensorData, initial: InitialState) -> None:
    """Raise AssertionError if values or covariance of a solution are not sound."""
    try:
        same = np.array_equal(check_solution(first).cov, first.cov, equal_nan=True)
    except ValueError as error:
        raise AssertionError(f"{error}") from None
    assert same, "covariance is not symmetric"
    np.testing.assert_array_equal(first.t, sensors.output_t, err_msg="t is not sensors.output_t")
    begun = 0
    if initial.alignment != "given":  # NaN until the alignment is done
        answered = ~np.isnan(first.cov.reshape(len(first), -1)).all(axis=1)
        begun = int(np.argmax(answered)) if answered.any() else 0
    variance = np.einsum("kii->ki", first.cov)[begun:]
    given = ~np.isnan(variance).all(axis=0)
    assert given.any() or not len(first), "no block of the solution has a covariance"
    for k, name in enumerate(("lla", "vel_n", "q_nb")):
        if given[3 * k : 3 * k + 3].any():
            assert np.isfinite(getattr(first, name)[begun:]).all(), f"{name} is not finite"
    cov = first.cov[begun:, given][:, :, given]
    assert np.isfinite(cov).all(), "covariance is not finite"
    assert (variance[:, given] > 0).all(), "a variance is not positive"
    scale = np.sqrt(variance[:, given])
    correlation = cov / scale[:, :, None] / scale[:, None, :]
    try:
        np.linalg.cholesky(correlation)
    except np.linalg.LinAlgError:
        raise AssertionError("covariance is not positive definite") from None
