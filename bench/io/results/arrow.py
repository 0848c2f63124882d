"""The records of a result as Arrow tables and pandas DataFrames, with the columns of its Parquet files."""

from __future__ import annotations

import sys
from collections.abc import Mapping
from typing import TYPE_CHECKING

from bench.core.records.run_result import RunResult
from bench.core.words.exceptions import BenchError
from bench.io.results.columns import flatten
from bench.io.results.parquet import to_table
from bench.io.results.result_folder import list_aiding

if TYPE_CHECKING:
    import pyarrow as pa


def to_arrow(result: RunResult, record: str, estimator: str | None = None) -> pa.Table:
    """Return one record of a result as an Arrow table; ``.to_pandas()`` makes a DataFrame of it.

    Parameters
    ----------
    result : RunResult
        Result from `bench.run`, `bench.navigate` or `bench.read_result`.
    record : str
        "errors", "solutions" or "innovations" of the filters; "truth", "air", "controls" or "rotors" of the
        flight; "imu", "gnss", "observations", "baro" ... of the sensors; "drawn", the true sensor
        errors; "sky"; "events".
    estimator : str, optional
        Filter whose rows are returned. Default: all filters, with a first column ``estimator``.

    Returns
    -------
    pyarrow.Table
        One row per time. Column names end in the unit (SI and radians); the metadata of a field has ``unit``
        and ``frame``. A state that a filter does not have is null.

    Raises
    ------
    bench.BenchError
        If the result has no such record or filter.

    Examples
    --------
    >>> import bench
    >>> result = bench.run("approach", estimators=["loose-15"], causes=False)
    >>> bench.to_arrow(result, "errors", "loose-15").column_names[:2]
    ['t_s', 'pos_err_n_m']
    """
    import pyarrow as pa

    by_estimator: dict[str, Mapping[str, object]] = {
        "errors": result.errors,
        "solutions": result.solutions,
        "innovations": {label: solution.innovations for label, solution in result.solutions.items()},
    }
    if record not in by_estimator:
        return _to_table(_choose(record, _list_records(result) | by_estimator))
    found = by_estimator[record]
    if estimator is not None:
        return _to_table(_choose(estimator, found))
    tables = []
    for label, rows in found.items():
        table = _to_table(rows)
        tables.append(table.add_column(0, "estimator", pa.array([label] * len(table), pa.string())))
    return pa.concat_tables(tables, promote_options="default") if tables else pa.table({})


class _WithoutPandas:
    """A finder of modules that reports pandas as missing."""

    @staticmethod
    def find_spec(name: str, path: object = None, target: object = None) -> None:
        """Raise ModuleNotFoundError for pandas."""
        if name == "pandas":
            raise ModuleNotFoundError("pandas is left out", name=name)


def leave_out_pandas() -> None:
    """Keep pyarrow from importing pandas for type checks, which would take a tenth of a run.

    For a process of the command line alone, because pyarrow checks once: then it takes a Series for a plain
    sequence, until its own conversion to pandas is called. Without effect once pandas is imported.
    """
    import pyarrow as pa

    if "pandas" not in sys.modules:
        sys.meta_path.insert(0, _WithoutPandas)
        try:
            pa.array([])
        finally:
            sys.meta_path.remove(_WithoutPandas)


def _to_table(record: object) -> pa.Table:
    return to_table(*flatten(record), {})


def _list_records(result: RunResult) -> dict[str, object]:
    """Return the records that belong to the flight and its sensors, not to a filter, by name."""
    found: dict[str, object] = {"events": result.events}
    if (truth := result.truth) is not None:
        found |= {"truth": truth, "air": truth.air, "controls": truth.controls}
        found |= {"rotors": truth.rotors} if len(truth.rotors) else {}
    if (sensed := result.sensed) is not None:
        found |= {"imu": sensed.data.imu, **list_aiding(sensed.data), "drawn": sensed.truth}
        found |= {"sky": sensed.sky} if sensed.sky is not None else {}
    return found


def _choose(name: str, found: Mapping[str, object]) -> object:
    if name not in found:
        raise BenchError(f"the result has no {name!r}; there are {', '.join(found)}")
    return found[name]
