"""A results folder: written as a whole or not at all, and read back."""

from __future__ import annotations

import json
import math
import os
import shutil
import tempfile
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from types import SimpleNamespace

import numpy as np

from bench.data import (
    AirData,
    Controls,
    ErrorSeries,
    Events,
    GnssFixes,
    GnssObservations,
    ImuData,
    Innovations,
    NavSolution,
    RunResult,
    Sensed,
    SensorTruth,
    Trajectory,
)
from bench.fields import columns_of
from bench.instruments import INSTRUMENTS, InstrumentData
from bench.store import columns, parquet
from bench.store.start import START, start_document

RESULT = "result.json"
RECORDING = "flight.rrd"
TRUTH = "truth.parquet"
OBSERVATIONS = "sensors-observations.parquet"
DRAWN = "sensors-drawn.parquet"


@contextmanager
def results_folder(folder: Path, *, replace: bool = False) -> Iterator[Path]:
    """Give a temporary folder beside the wanted one, and put it in its place when all went well.

    Parameters
    ----------
    folder : Path
        Where the results shall be.
    replace : bool
        Replace an existing folder.

    Yields
    ------
    partial : Path
        The folder to write to. After an exception, Ctrl-C included, it is gone.

    Raises
    ------
    FileExistsError
        When the folder exists and is not to be replaced.
    """
    folder.parent.mkdir(parents=True, exist_ok=True)
    scratch = Path(tempfile.mkdtemp(prefix=f".{folder.name}-", dir=folder.parent))
    try:
        partial = scratch / "new"
        partial.mkdir()
        yield partial
        if folder.exists():
            if not replace:
                raise FileExistsError(f"{folder} exists")
            folder.rename(scratch / "old")
        try:
            partial.rename(folder)
        except BaseException:
            if (scratch / "old").exists():
                (scratch / "old").rename(folder)
            raise
    finally:
        shutil.rmtree(scratch, ignore_errors=True)


def save(
    folder: Path,
    result: RunResult,
    truth: Trajectory | None,
    sensed: Sensed,
    more: Mapping[str, object] | None = None,
) -> None:
    """Write one run into an existing, empty folder: Parquet tables, then ``result.json``.

    A recording has no truth and nothing that was drawn; ``more`` is what else its ``result.json`` says.

    Raises
    ------
    OSError
        When the disk does not take it.
    """
    data = sensed.data
    if truth is not None:
        _save_truth(folder, truth)
        _save_drawn(folder / DRAWN, sensed.truth)
    parquet.write(folder / "sensors-imu.parquet", data.imu, columns.IMU)
    if data.fixes is not None:
        parquet.write(folder / "sensors-gnss.parquet", data.fixes, columns.GNSS)
    if data.observations is not None:
        _save_observations(folder / OBSERVATIONS, data.observations)
    if sensed.sky is not None:
        parquet.write(folder / "sensors-sky.parquet", sensed.sky, columns.SKY)
    for name, record in data.instruments.items():
        parquet.write(folder / f"sensors-{name}.parquet", record, columns_of(type(record)), date=data.date)
    write_json(folder / START, start_document(data, sensed.initial))
    parquet.write(folder / "sensors-events.parquet", sensed.events, columns.EVENTS)
    for label, solution in result.solutions.items():
        _save_solution(folder, label, solution)
    for label, errors in result.errors.items():
        parquet.write(folder / f"errors-{label}.parquet", errors, columns.ERRORS, states=errors.states)
    summary = {
        "profile": result.profile,
        "seed": result.seed,
        "run": result.run,
        "metrics": result.metrics,
        "provenance": result.provenance,
        **(more or {}),
    }
    write_json(folder / RESULT, summary)


def add_solution(
    folder: Path, label: str, solution: NavSolution, errors: ErrorSeries, metrics: Mapping[str, object]
) -> None:
    """Write one more solution into a results folder.

    Raises
    ------
    OSError
        When the disk does not take it.
    """
    summary = json.loads((folder / RESULT).read_text(encoding="utf-8"))
    _save_solution(folder, label, solution)
    parquet.write(folder / f"errors-{label}.parquet", errors, columns.ERRORS, states=errors.states)
    summary["metrics"][label] = metrics
    write_json(folder / RESULT, summary)


def _save_solution(folder: Path, label: str, solution: NavSolution) -> None:
    layout = columns.solution(solution.extra_names)
    extra_names = list(solution.extra_names)
    parquet.write(folder / f"solution-{label}.parquet", solution, layout, extra_names=extra_names)
    parquet.write(folder / f"events-{label}.parquet", solution.events, columns.EVENTS)
    _save_innovations(folder / f"innovations-{label}.parquet", solution.innovations)


def load(folder: str | os.PathLike[str]) -> RunResult:
    """Read a results folder back.

    Parameters
    ----------
    folder : path
        A folder that ``bench run`` wrote.

    Returns
    -------
    result : RunResult
        As it was, except that a metric that was not finite is None.

    Raises
    ------
    FileNotFoundError
        When it is no results folder.
    """
    folder = Path(folder)
    summary = json.loads((folder / RESULT).read_text(encoding="utf-8"))
    return RunResult(
        profile=summary["profile"],
        seed=summary["seed"],
        run=summary["run"],
        metrics=summary["metrics"],
        errors={label: _load_errors(path) for label, path in _labelled(folder, "errors")},
        solutions={label: load_solution(folder, label) for label, _ in _labelled(folder, "solution")},
        provenance=summary["provenance"],
    )


def load_truth(folder: str | os.PathLike[str]) -> Trajectory:
    """Read the truth of a results folder back."""
    folder = Path(folder)
    motion = parquet.read(folder / TRUTH, {**columns.MOTION, **columns.INCREMENTS})
    motion |= {name: motion[name][1:] for name in columns.INCREMENTS}  # the first row ends no interval
    return Trajectory(
        **motion,
        air=AirData(**parquet.read(folder / "truth-air.parquet", columns.AIR)),
        controls=Controls(**parquet.read(folder / "truth-controls.parquet", columns.CONTROLS)),
        events=Events(**parquet.read(folder / "truth-events.parquet", columns.EVENTS)),
    )


def load_sensors(
    folder: str | os.PathLike[str],
) -> tuple[ImuData, GnssFixes | None, dict[str, InstrumentData]]:
    """Read the sensor records of a results folder back: IMU, fixes, and the instruments on board by name."""
    folder = Path(folder)
    imu = ImuData(**parquet.read(folder / "sensors-imu.parquet", columns.IMU))
    gnss = folder / "sensors-gnss.parquet"
    fixes = GnssFixes(**parquet.read(gnss, columns.GNSS)) if gnss.exists() else None
    instruments = {}
    for name, row in INSTRUMENTS.items():
        path = folder / f"sensors-{name}.parquet"
        if path.exists():
            instruments[name] = row.record(**parquet.read(path, columns_of(row.record)))
    return imu, fixes, instruments


def load_observations(folder: str | os.PathLike[str]) -> GnssObservations | None:
    """Read the GNSS observations of a results folder back; None when its receiver gave only fixes."""
    path = Path(folder) / OBSERVATIONS
    if not path.exists():
        return None
    facts = parquet.facts(path)
    start = np.array(facts["epoch_start"], np.int64)
    return GnssObservations(
        **parquet.read(path, columns.observations(facts["bands"])),
        epoch_start=start,
        klobuchar=np.array(facts["klobuchar"]),
        gps_t0=facts["gps_t0"],
    )


def _save_observations(path: Path, record: GnssObservations) -> None:
    bands = record.pseudorange.shape[1]
    parquet.write(
        path,
        record,
        columns.observations(bands),
        bands=bands,
        epoch_start=record.epoch_start.tolist(),
        klobuchar=record.klobuchar.tolist(),
        gps_t0=record.gps_t0,
    )


def write_json(path: Path, value: object) -> None:
    """Write a value as JSON, atomically; what is not a finite number becomes null.

    Raises
    ------
    OSError
        When the disk does not take it; the file is then as it was.
    """
    part = path.with_name(f".{path.name}.{os.getpid()}")
    try:
        part.write_text(to_json(value), encoding="utf-8")
        part.replace(path)
    finally:
        part.unlink(missing_ok=True)


def to_json(value: object) -> str:
    """Write a value as JSON; what is not a finite number becomes null.

    Examples
    --------
    >>> to_json({"pos_rmse_h_m": np.float64(1.5), "drift_m": float("nan")})
    '{\\n  "pos_rmse_h_m": 1.5,\\n  "drift_m": null\\n}\\n'
    """
    return json.dumps(_plain(value), indent=2, allow_nan=False) + "\n"


def _plain(value: object) -> object:
    if isinstance(value, np.generic | np.ndarray):
        value = value.tolist()
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    if isinstance(value, Mapping):
        return {str(key): _plain(inner) for key, inner in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(inner) for inner in value]
    return value


def _save_truth(folder: Path, truth: Trajectory) -> None:
    no_interval = np.full((1, 3), np.nan)  # the first instant ends no interval
    motion = SimpleNamespace(
        t=truth.t,
        lla=truth.lla,
        vel_n=truth.vel_n,
        q_nb=truth.q_nb,
        dtheta_b=np.vstack([no_interval, truth.dtheta_b]),
        dvel_b=np.vstack([no_interval, truth.dvel_b]),
    )
    parquet.write(folder / TRUTH, motion, {**columns.MOTION, **columns.INCREMENTS})
    parquet.write(folder / "truth-air.parquet", truth.air, columns.AIR)
    parquet.write(folder / "truth-controls.parquet", truth.controls, columns.CONTROLS)
    parquet.write(folder / "truth-events.parquet", truth.events, columns.EVENTS)


def _save_drawn(path: Path, truth: SensorTruth) -> None:
    fields = {name: getattr(truth, name) for name in columns_of(SensorTruth)} | dict(truth.bias)
    parquet.write(path, SimpleNamespace(**fields), columns.drawn(tuple(truth.bias)))


def _save_innovations(path: Path, innovations: Innovations) -> None:
    """Write innovations with the name of their sensor in each row instead of its code."""
    names = innovations.sensor
    fields = {name: getattr(innovations, name) for name in columns.INNOVATIONS}
    fields["sensor"] = tuple(names[code] for code in innovations.code)
    parquet.write(path, SimpleNamespace(**fields), columns.INNOVATIONS, sensors=list(names))


def solutions_of(folder: str | os.PathLike[str]) -> list[str]:
    """Return the labels of the solutions in a results folder."""
    return [label for label, _ in _labelled(Path(folder), "solution")]


def load_solution(folder: str | os.PathLike[str], label: str) -> NavSolution:
    """Read one solution of a results folder back."""
    folder = Path(folder)
    path, other = folder / f"solution-{label}.parquet", folder / f"innovations-{label}.parquet"
    extra_names = tuple(parquet.facts(path)["extra_names"])
    names = tuple(parquet.facts(other)["sensors"])
    rows = parquet.read(other, columns.INNOVATIONS)
    code = np.array([names.index(name) for name in rows["sensor"]], dtype=np.int64)
    return NavSolution(
        **parquet.read(path, columns.solution(extra_names)),
        extra_names=extra_names,
        innovations=Innovations(**{**rows, "sensor": names, "code": code}),
        events=Events(**parquet.read(folder / f"events-{label}.parquet", columns.EVENTS)),
    )


def _load_errors(path: Path) -> ErrorSeries:
    return ErrorSeries(**parquet.read(path, columns.ERRORS), states=parquet.facts(path)["states"])


def _labelled(folder: Path, kind: str) -> list[tuple[str, Path]]:
    """Return label and file of every estimator that has a file of one kind."""
    return [(path.stem.removeprefix(f"{kind}-"), path) for path in sorted(folder.glob(f"{kind}-*.parquet"))]
