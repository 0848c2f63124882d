"""Write a results folder, completely or not at all, and read it back."""

from __future__ import annotations

import json
import math
import os
import shutil
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, TypeVar

import numpy as np

from bench.core.files import durable
from bench.core.mathematics.arrays import FloatArray
from bench.core.records.data import (
    AirData,
    Controls,
    Events,
    GnssFixes,
    GnssObservations,
    ImuData,
    Innovations,
    NavSolution,
    SensorData,
    Trajectory,
)
from bench.core.records.fields import columns_of
from bench.core.records.instruments import INSTRUMENTS, InstrumentData
from bench.core.records.rotor_speeds import Rotors, no_rotors
from bench.core.records.run_records import (
    ErrorSeries,
    OffPath,
    Reference,
    Sensed,
    SensorTruth,
    SkyView,
    no_sensor_truth,
)
from bench.core.records.run_result import RunResult
from bench.core.words.exceptions import ConfigError
from bench.core.words.renames import FORMAT
from bench.io.results import columns, parquet
from bench.io.results.damage import RESULT, SUMMARY, TRUTH, read_summary, report_damage
from bench.io.results.start_document import (
    START,
    load_start,
    make_sensor_data,
    make_start_document,
    read_initial_state,
)

RECORDING = "flight.rrd"
REPORT = "report.html"
CAMPAIGN_RESULT = "campaign.json"
"""File with the figures and sentences of a campaign."""
STUDY_RESULT = "study.json"
"""File with the sentences, the options and the command of a study."""
OBSERVATIONS = "sensors-observations.parquet"
DRAWN = "sensors-drawn.parquet"
SKY = "sensors-sky.parquet"
EVENTS = "sensors-events.parquet"
WITHHELD, REFERENCE = "sensors-withheld.parquet", "reference.parquet"
"""What evaluates a log: fixes that no filter got, or the reference."""
PATH = "truth-path.parquet"
"""How far a flight that an estimate flew was off its path."""
PRINTED = "printed-{}.txt"
"""File with what the filter of a label has printed."""
_T = TypeVar("_T")


def save(folder: Path, result: RunResult) -> None:
    """Write one run and its records into an existing, empty folder: Parquet tables, then ``result.json``.

    A result from recorded data has no truth and no drawn sensor errors.

    Raises
    ------
    OSError
        If the file cannot be written.
    """
    sensed = result.sensed
    assert sensed is not None
    data, truth = sensed.data, result.truth
    if truth is not None:
        parquet.write(folder / TRUTH, truth)
        for name in ("air", "controls", "events", *(["rotors"] if len(truth.rotors) else [])):
            parquet.write(folder / f"truth-{name}.parquet", getattr(truth, name))
        parquet.write(folder / DRAWN, sensed.truth)
    for name, record in list_aiding(data).items():
        parquet.write(folder / f"sensors-{name}.parquet", record, **describe_record(record, data))
    parquet.write(folder / "sensors-imu.parquet", data.imu)
    if sensed.sky is not None:
        parquet.write(folder / SKY, sensed.sky)
    write_json(folder / START, make_start_document(data, sensed.initial))
    parquet.write(folder / EVENTS, sensed.events)
    if (path := result.records.get("path")) is not None:
        parquet.write(folder / PATH, path)
    if (withheld := result.records.get("withheld")) is not None:
        parquet.write(folder / WITHHELD, withheld)
    if (reference := result.records.get("reference")) is not None:
        point = reference.point_b.tolist()
        parquet.write(folder / REFERENCE, reference.track, extra_names=[], point_b_m=point)
    for label, solution in result.solutions.items():
        _save_solution(folder, label, solution)
    for label, text in result.records.get("printed", {}).items():
        durable.write(folder / PRINTED.format(label), text)
    for label, errors in result.errors.items():
        parquet.write(folder / f"errors-{label}.parquet", errors, states=errors.states)
    summary = {name: getattr(result, name) for name in SUMMARY}
    write_json(folder / RESULT, {"format": FORMAT, **summary, **result.more})


def list_aiding(data: SensorData) -> dict[str, Any]:
    """Return the GNSS and instrument records on board, by the name of their table."""
    receiver = {"gnss": data.fixes, "observations": data.observations}
    return {name: record for name, record in receiver.items() if record is not None} | data.instruments


def describe_record(record: object, data: SensorData) -> dict[str, Any]:
    """Return the facts to store in the file of a record beside its columns."""
    if isinstance(record, GnssObservations):
        return {
            "bands": record.pseudorange.shape[1],
            "epoch_start": record.epoch_start.tolist(),
            "klobuchar": record.klobuchar.tolist(),
            "gps_t0": record.gps_t0,
        }
    return {"date": data.date} if isinstance(record, InstrumentData) else {}


def add_solution(
    folder: Path, label: str, solution: NavSolution, errors: ErrorSeries, metrics: Mapping[str, object]
) -> None:
    """Write one more solution into a results folder.

    Raises
    ------
    OSError
        If the file cannot be written.
    """
    summary = read_summary(folder)
    _save_solution(folder, label, solution)
    parquet.write(folder / f"errors-{label}.parquet", errors, states=errors.states)
    summary["metrics"][label] = metrics
    write_json(folder / RESULT, {"format": FORMAT, **summary})


def copy_results(folder: Path, to: Path) -> None:
    """Copy the files of a results folder into another folder, without its recording and without other files.

    Raises
    ------
    OSError
        If a file cannot be read or written.
    """
    for path in folder.iterdir():
        if path.is_file() and any(path.match(pattern) for pattern in _FILES):
            shutil.copy2(path, to / path.name)


_TABLES = ("truth", "sensors", "solution", "events", "innovations", "errors")
_FILES = (RESULT, START, TRUTH, REFERENCE, PRINTED.format("*"), *(f"{kind}-*.parquet" for kind in _TABLES))
"""Names of the files of a results folder besides its recording."""


def _save_solution(folder: Path, label: str, solution: NavSolution) -> None:
    names, sensors = list(solution.extra_names), list(solution.innovations.sensor)
    parquet.write(folder / f"solution-{label}.parquet", solution, extra_names=names)
    parquet.write(folder / f"events-{label}.parquet", solution.events)
    parquet.write(folder / f"innovations-{label}.parquet", solution.innovations, sensors=sensors)


def read_result(folder: str | os.PathLike[str]) -> RunResult:
    """Read a results folder.

    Parameters
    ----------
    folder : str or Path
        Folder that ``bench run`` or `write_result` wrote.

    Returns
    -------
    RunResult
        The result as written; a metric that was not finite is None. Truth and sensors are read on first use.

    Raises
    ------
    bench.ConfigError
        If the folder is not a results folder, was written by a newer bench, or is damaged.

    Examples
    --------
    >>> import bench, tempfile
    >>> result = bench.run("approach", estimators=["loose-15"], causes=False)
    >>> with tempfile.TemporaryDirectory() as place:
    ...     folder = bench.write_result(result, place + "/a", recording=False, report=False)
    ...     again = bench.read_result(folder)
    >>> again.metrics == result.metrics
    True
    """
    folder = Path(folder)
    summary = read_summary(folder)
    with report_damage(folder):
        errors = {label: _load_errors(path) for label, path in _find_files(folder, "errors")}
        solutions = {label: load_solution(folder, label) for label, _ in _find_files(folder, "solution")}
    for label, errors_of in errors.items():
        if label in solutions and not np.isin(errors_of.t, solutions[label].t).all():
            raise ConfigError(f"{folder}: errors-{label}.parquet has epochs that its solution has not")
    labels = list(summary["metrics"])
    without = sorted(set(labels) - set(solutions))
    if without:
        raise ConfigError(f"{folder}: metrics of {without[0]!r}, but no solution-{without[0]}.parquet")
    return RunResult(
        **{name: summary.pop(name) for name in SUMMARY},
        errors=_order(errors, labels),
        solutions=_order(solutions, labels),
        more=summary,
        records=FolderRecords(folder),
    )


def _order(by_label: Mapping[str, _T], labels: Sequence[str]) -> dict[str, _T]:
    """Return records in the order in which the filters ran; those without metrics follow."""
    return {label: by_label[label] for label in (*labels, *by_label) if label in by_label}


class FolderRecords(Mapping[str, Any]):
    """The truth and the sensors of a results folder, each read on first use."""

    def __init__(self, folder: Path) -> None:
        self._folder, self._read = folder.absolute(), dict[str, Any]()

    def __getitem__(self, name: str) -> Any:
        if name not in self._read:
            if name not in self:
                raise KeyError(name)
            with report_damage(self._folder):
                self._read[name] = _READERS[name][1](self._folder)
        return self._read[name]

    def __contains__(self, name: object) -> bool:
        return name in set(self)

    def __iter__(self) -> Iterator[str]:
        return (name for name, (file, _) in _READERS.items() if (self._folder / file).exists())

    def __len__(self) -> int:
        return sum(1 for _ in self)


def load_truth(folder: str | os.PathLike[str]) -> Trajectory:
    """Read the truth of a results folder back."""
    folder = Path(folder)
    motion = parquet.read(folder / TRUTH, columns.TRUTH)
    motion |= {name: motion[name][1:] for name in ("dtheta_b", "dvel_b")}  # the first row ends no interval
    return Trajectory(
        **motion,
        air=_load(folder / "truth-air.parquet", AirData),
        controls=_load(folder / "truth-controls.parquet", Controls),
        events=_load(folder / "truth-events.parquet", Events),
        rotors=_load(rotors, Rotors) if (rotors := folder / "truth-rotors.parquet").exists() else no_rotors(),
    )


def load_sensors(
    folder: str | os.PathLike[str],
) -> tuple[ImuData, GnssFixes | None, dict[str, InstrumentData]]:
    """Read the sensor records of a results folder back: IMU, fixes, and the instruments on board by name."""
    folder = Path(folder)
    gnss = folder / "sensors-gnss.parquet"
    paths = {name: folder / f"sensors-{name}.parquet" for name in INSTRUMENTS}
    return (
        _load(folder / "sensors-imu.parquet", ImuData),
        _load(gnss, GnssFixes) if gnss.exists() else None,
        {name: _load(path, INSTRUMENTS[name].record) for name, path in paths.items() if path.exists()},
    )


def load_output_times(folder: str | os.PathLike[str]) -> FloatArray:
    """Read the requested epochs (M,) of the filters of a results folder [s]; empty if all filters failed."""
    paths = [path for _, path in _find_files(Path(folder), "solution")]
    outputs = (parquet.read(path, {"t": columns.TRUTH["t"]})["t"] for path in paths)
    return next((t for t in outputs if np.isfinite(t).all()), np.empty(0))


def load_sensed(folder: str | os.PathLike[str]) -> Sensed:
    """Read back the sensor data of a results folder, the initial state and the drawn sensor errors.

    The satellites of a sky come back only as the receiver computes them, in its observations.
    """
    folder = Path(folder)
    imu, fixes, instruments = load_sensors(folder)
    start = load_start(folder)
    data = make_sensor_data(
        start, imu, fixes, instruments, load_output_times(folder), load_observations(folder)
    )
    drawn, sky = folder / DRAWN, folder / SKY
    return Sensed(
        data,
        read_initial_state(start),
        _load_drawn(drawn) if drawn.exists() else no_sensor_truth(),
        _load(folder / EVENTS, Events),
        _load(sky, SkyView) if sky.exists() else None,
    )


def _load_withheld(folder: Path) -> GnssFixes:
    return _load(folder / WITHHELD, GnssFixes)


def _load_path(folder: Path) -> OffPath:
    return _load(folder / PATH, OffPath)


def _load_reference(folder: Path) -> Reference:
    path = folder / REFERENCE
    track = NavSolution(**parquet.read(path, columns.solution_layout(())), extra_names=())
    return Reference(track, np.array(parquet.read_facts(path)["point_b_m"]))


def _load_printed(folder: Path) -> dict[str, str]:
    paths = sorted(folder.glob(PRINTED.format("*")))
    begin = len(PRINTED.partition("{")[0])
    return {path.stem[begin:]: path.read_text(encoding="utf-8", errors="replace") for path in paths}


def _load_drawn(path: Path) -> SensorTruth:
    names = parquet.read_names(path)
    on_board = [name for name, row in INSTRUMENTS.items() if row.bias.names[0] in names]
    fields = parquet.read(path, columns.drawn_layout(on_board))
    bias = {name: fields.pop(name).reshape(len(fields["t"]), -1) for name in on_board}
    return SensorTruth(**fields, bias=bias)


_READERS: Mapping[str, tuple[str, Callable[[Path], Any]]] = {
    "truth": (TRUTH, load_truth),
    "sensed": (START, load_sensed),
    "path": (PATH, _load_path),
    "withheld": (WITHHELD, _load_withheld),
    "reference": (REFERENCE, _load_reference),
    "printed": (RESULT, _load_printed),
}
"""Record of a result -> the file a folder must have to hold it, and the function that reads it."""


def _load(path: Path, record: type[_T]) -> _T:
    try:
        return record(**parquet.read(path, columns_of(record)))
    except KeyError as error:
        what = str(error.args[0]).splitlines()[0]
        raise ConfigError(f"{path}: {what}; another version of bench wrote it: run it again") from None


def load_observations(folder: str | os.PathLike[str]) -> GnssObservations | None:
    """Read the GNSS observations of a results folder back; None if its receiver gave only fixes."""
    path = Path(folder) / OBSERVATIONS
    if not path.exists():
        return None
    facts = parquet.read_facts(path)
    start = np.array(facts["epoch_start"], np.int64)
    return GnssObservations(
        **parquet.read(path, columns.observation_layout(facts["bands"])),
        epoch_start=start,
        klobuchar=np.array(facts["klobuchar"]),
        gps_t0=facts["gps_t0"],
    )


def write_json(path: Path, value: object) -> None:
    """Write a value to a JSON file, atomically; NaN and infinity become null.

    Raises
    ------
    OSError
        If the file cannot be written; an existing file is left unchanged.
    """
    durable.write(path, to_json(value))


def to_json(value: object) -> str:
    """Return a value as JSON text; NaN and infinity become null.

    Examples
    --------
    >>> to_json({"pos_rmse_h_m": np.float64(1.5), "drift_m": float("nan")})
    '{\\n  "pos_rmse_h_m": 1.5,\\n  "drift_m": null\\n}\\n'
    """
    return json.dumps(_to_plain(value), indent=2, allow_nan=False) + "\n"


def _to_plain(value: object) -> object:
    if isinstance(value, np.generic | np.ndarray):
        value = value.tolist()
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    if isinstance(value, Mapping):
        return {str(key): _to_plain(inner) for key, inner in value.items()}
    if isinstance(value, list | tuple):
        return [_to_plain(inner) for inner in value]
    return value


def list_solutions(folder: str | os.PathLike[str]) -> list[str]:
    """Return the labels of the solutions in a results folder."""
    return [label for label, _ in _find_files(Path(folder), "solution")]


def load_solution(folder: str | os.PathLike[str], label: str) -> NavSolution:
    """Read one solution of a results folder back."""
    folder = Path(folder)
    path, other = folder / f"solution-{label}.parquet", folder / f"innovations-{label}.parquet"
    extra_names = tuple(parquet.read_facts(path)["extra_names"])
    names = tuple(parquet.read_facts(other)["sensors"])
    rows = parquet.read(other, columns.INNOVATIONS)
    code = np.array([names.index(name) for name in rows["sensor"]], dtype=np.int64)
    return NavSolution(
        **parquet.read(path, columns.solution_layout(extra_names)),
        extra_names=extra_names,
        innovations=Innovations(**{**rows, "sensor": names, "code": code}),
        events=_load(folder / f"events-{label}.parquet", Events),
    )


def _load_errors(path: Path) -> ErrorSeries:
    return ErrorSeries(
        **parquet.read(path, columns_of(ErrorSeries)), states=parquet.read_facts(path)["states"]
    )


def _find_files(folder: Path, kind: str) -> list[tuple[str, Path]]:
    """Return label and file of each filter that has a file of the given kind."""
    return [(path.stem.removeprefix(f"{kind}-"), path) for path in sorted(folder.glob(f"{kind}-*.parquet"))]
