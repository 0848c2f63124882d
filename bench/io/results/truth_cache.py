"""The cache of flown truth: found by content hash, written atomically, read memory-mapped, never unpickled.

A flight is flown and written in pieces, so that a long one needs no more memory than a short one. A piece is
a `Trajectory` that begins at the last epoch of the piece before. The columns in `SHARED` repeat that
time; all others hold only later rows.
"""

from __future__ import annotations

import contextlib
import dataclasses
import hashlib
import json
import logging
import os
import shutil
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import IO, Any

import numpy as np

from bench.core.files import disk_arrays, durable
from bench.core.files.places import cache_folder, locate_source
from bench.core.files.scratch import LOCK, make_scratch
from bench.core.records.data import AirData, Controls, Events, Trajectory
from bench.core.records.flight_specs import Flight, FlightSpec, ScriptSpec
from bench.core.records.rotor_speeds import Rotors
from bench.io.results.cache_size import hold_entry, read_hashed, read_limit, trim_cache, write_hashed
from bench.io.results.provenance import list_versions

_BLOCK = 1 << 20  # [byte]
_LOG = logging.getLogger(__name__)

_INDEX = "index.json"  # SHA-256 of every other file of an entry
_TEXTS = "texts.json"
_PARTS = ("air", "controls", "events", "rotors")
_EVENT_TEXTS = ("kind", "text", "sensor")
PIECE = 6000  # samples of truth read at a time: 30 s at 200 Hz
_Array = np.ndarray[Any, Any]
SHARED = ("t", "lla", "vel_n", "q_nb", "rotors.t", "rotors.speed")
"""Columns in which a piece repeats the last row of the piece before."""

SOURCES = (
    "bench/simulation/flight",
    "bench/io/logs/formats/nmea_sentences.py",
    "bench/io/logs/mat_files",
    "bench/io/logs/table_files.py",
    "bench/io/trajectories/motion_commands.py",
    "bench/io/trajectories/track_files.py",
    "bench/io/trajectories/track_fit.py",
    "bench/io/trajectories/track_motion.py",
    "bench/io/trajectories/trajectory.py",
    "bench/simulation/signals/terrain.py",
    "bench/core/records/fields.py",
    "bench/core/mathematics/units.py",
    "bench/core/mathematics/rotation.py",
    "bench/core/mathematics/earth.py",
    "bench/core/mathematics/arrays.py",
    "bench/core/records/data.py",
    "bench/core/records/flight_specs.py",
    "bench/core/records/rotor_speeds.py",
    "bench/core/mathematics/random_streams.py",
)
"""Files and folders that truth depends on."""

LOOP_SOURCES = (
    "bench/pipeline/closed_loop.py",
    "bench/core/records/instruments.py",
    "bench/navigation",
    "bench/plugins",
    "bench/simulation/sensors",
    "bench/simulation/signals",
)
"""The same where an estimate flies."""


def cached_truth(spec: Flight, fly: Callable[[], Iterable[Trajectory]]) -> Trajectory:
    """Return the truth of a flight from the cache; if it is missing, fly and store it first.

    Parameters
    ----------
    spec : FlightSpec, ScriptSpec or TableSpec
        Everything the truth depends on, besides the files it names and the software.
    fly : callable
        Flies and returns the pieces, at least one. Called if the truth is not in the cache or is damaged
        there, and a second time if it could not be stored.

    Returns
    -------
    truth : Trajectory
        Bit-identical to the joined pieces of ``fly``; its columns are memory-mapped from the cache.
    """
    entry = cache_folder("truth") / truth_key(spec)
    with hold_entry(entry):
        truth = _map_truth(entry) if _is_sound(entry) else None
    if truth is None and _fly_into(entry, fly):
        truth = _map_truth(entry)
    return join_pieces(fly()) if truth is None else truth


def read_truth(key: str) -> Trajectory | None:
    """Return the truth with this :func:`truth_key` from the cache, memory-mapped; None if it is not there."""
    entry = cache_folder("truth") / key
    with hold_entry(entry):
        return _map_truth(entry) if _is_sound(entry) else None


def write_truth(key: str, truth: Trajectory) -> None:
    """Write a truth that was flown elsewhere into the cache, unless it is there."""
    _fly_into(cache_folder("truth") / key, lambda: [truth])


def truth_pieces(spec: Flight, fly: Callable[[], Iterable[Trajectory]]) -> Iterator[Trajectory]:
    """Yield the truth of a flight in pieces, one in memory at a time; arguments as for `cached_truth`.

    A flight that is not in the cache is flown and stored first.
    """
    entry = cache_folder("truth") / truth_key(spec)
    with hold_entry(entry):
        if _is_sound(entry):
            yield from _read_pieces(entry)
            return
    if _fly_into(entry, fly):
        with hold_entry(entry):
            yield from _read_pieces(entry)
    else:
        yield from fly()


def cached_summary(
    spec: Flight,
    fly: Callable[[], Iterable[Trajectory]],
    summarize: Callable[[Iterable[Trajectory]], dict[str, Any]],
    sources: Sequence[str],
) -> dict[str, Any]:
    """Return the summary of a truth: computed once, then stored beside the truth.

    Parameters
    ----------
    spec, fly
        As for `cached_truth`; a truth that is not in the cache is flown and stored first.
    summarize : callable
        Makes a JSON object from the pieces.
    sources : sequence of str
        Files of the package that ``summarize`` depends on, besides those the truth depends on.
    """
    entry = cache_folder("truth") / truth_key(spec)
    digest = hashlib.sha256()
    for name in sources:
        digest.update(locate_source(name).read_bytes())
    path = entry / f"summary-{digest.hexdigest()[:32]}.json"
    if _is_sound(entry):
        with contextlib.suppress(OSError, ValueError):  # absent or changed: compute it again
            return read_hashed(path)
    summary: dict[str, Any] = json.loads(json.dumps(summarize(truth_pieces(spec, fly))))
    with contextlib.suppress(OSError):  # the truth could not be stored either
        write_hashed(path, summary)
    return summary


def truth_key(spec: Flight, flown_by: Sequence[str] = ()) -> str:
    """Return a hash of everything a truth depends on: the flight, the files it names, the software.

    ``flown_by`` is what else it depends on where an estimate flies; then the code of the filters counts, too.
    """
    values, files = _list_inputs(spec)
    if flown_by:
        values["flown_by"] = list(flown_by)
        files += map(locate_source, LOOP_SOURCES)
    digest = hashlib.sha256()
    digest.update(json.dumps({**values, "versions": list_versions()}, sort_keys=True).encode())
    for root in (*files, *map(locate_source, SOURCES)):
        for path in _list_files(root):
            digest.update(f"{root.name}/{path.relative_to(root)}\0{path.stat().st_size}\0".encode())
            with path.open("rb") as file:
                while block := file.read(_BLOCK):
                    digest.update(block)
    return digest.hexdigest()[:32]


def _list_inputs(spec: Flight) -> tuple[dict[str, Any], list[Path]]:
    """Return the values of a flight spec, and the files and folders it reads."""
    values = {"kind": type(spec).__name__, **dataclasses.asdict(spec)}
    if isinstance(spec, FlightSpec):
        aircraft, foreign = values["aircraft"], values["aircraft"]["foreign"]
        files = [Path(aircraft.pop("folder")), Path(aircraft.pop("systems"))]
        files += _list_engine_folders(Path(foreign.pop("root"))) if foreign else []
        values["legs"] = [[type(leg).__name__, dataclasses.asdict(leg)] for leg in spec.legs]
        if spec.terrain is not None:  # its digest stands for the file
            values["terrain"].pop("path")
        return values, files
    files = [Path(values.pop("path"))]
    if isinstance(spec, ScriptSpec):
        root = Path(values.pop("root"))
        files += [root / "aircraft" / spec.aircraft, *_list_engine_folders(root)]
    return values, files


def _list_engine_folders(root: Path) -> list[Path]:
    return [root / "engine", root / "systems"]


def _list_files(root: Path) -> list[Path]:
    if root.is_file():
        return [root]
    return sorted(p for p in root.rglob("*") if p.is_file() and p.suffix not in (".pyc", ".md"))


def get_columns(truth: Trajectory) -> dict[str, _Array]:
    """Return the numeric columns of a trajectory by name: ``lla``, ``air.t`` ..."""
    parts: dict[str, Any] = {"": truth} | {part: getattr(truth, part) for part in _PARTS}
    return {
        f"{part}.{field.name}".lstrip("."): getattr(record, field.name)
        for part, record in parts.items()
        for field in dataclasses.fields(record)
        if isinstance(getattr(record, field.name), np.ndarray)
    }


def _make_trajectory(arrays: Mapping[str, _Array], texts: Mapping[str, Sequence[str]]) -> Trajectory:
    """Return the trajectory that has these columns, named as `get_columns` names them."""
    rows: dict[str, dict[str, Any]] = {part: {} for part in ("", *_PARTS)}
    for label, array in arrays.items():
        part, _, name = label.rpartition(".")
        rows[part][name] = array
    rows["events"].update({name: tuple(texts[name]) for name in _EVENT_TEXTS})
    events = Events(**rows["events"])
    air, controls, rotors = AirData(**rows["air"]), Controls(**rows["controls"]), Rotors(**rows["rotors"])
    return Trajectory(**rows[""], air=air, controls=controls, events=events, rotors=rotors)


def join_pieces(pieces: Iterable[Trajectory]) -> Trajectory:
    """Return the pieces of a truth joined to one trajectory."""
    first, *rest = pieces
    if not rest:
        return first
    arrays = {name: [array] for name, array in get_columns(first).items()}
    for piece in rest:
        for name, array in get_columns(piece).items():
            arrays[name].append(array[name in SHARED :])
    events = [piece.events for piece in (first, *rest)]
    texts = {part: [text for e in events for text in getattr(e, part)] for part in _EVENT_TEXTS}
    return _make_trajectory({name: np.concatenate(parts) for name, parts in arrays.items()}, texts)


def _fly_into(entry: Path, fly: Callable[[], Iterable[Trajectory]]) -> bool:
    """Fly a truth into the cache; return whether it could be stored."""
    limit = read_limit()  # wrong: told before the flight
    if (entry / _INDEX).exists() and not _is_sound(entry):
        _LOG.warning("the truth in %s is damaged; it is flown again", entry)
    try:
        _write_entry(entry, fly)
        trim_cache(limit, keep=entry)
    except OSError as error:  # disk full, or no permission
        _LOG.warning("truth is not cached in %s: %s", entry.parent, error.strerror or error)
        return False
    return True


def _write_entry(entry: Path, fly: Callable[[], Iterable[Trajectory]]) -> None:
    entry.parent.mkdir(parents=True, exist_ok=True)
    with make_scratch(entry.parent) as scratch:
        new = scratch / "new"
        new.mkdir()
        columns: dict[str, GrowingColumn] = {}
        texts: dict[str, list[str]] = {name: [] for name in _EVENT_TEXTS}
        with contextlib.ExitStack() as files:
            for number, piece in enumerate(fly()):
                for name, array in get_columns(piece).items():
                    if not number:
                        file = files.enter_context(durable.open_binary(new / f"{name}.npy"))
                        columns[name] = GrowingColumn(file, array)
                    columns[name].append(array[number > 0 and name in SHARED :])
                for name in _EVENT_TEXTS:
                    texts[name] += getattr(piece.events, name)
            for column in columns.values():
                column.finish()
        durable.write(new / _TEXTS, json.dumps(texts))
        write_hashed(new / _INDEX, {path.name: hash_file(path) for path in new.iterdir()})
        (new / LOCK).touch()
        if not _is_sound(entry):  # else another process has just written it
            durable.sync_tree(new)
            shutil.rmtree(entry, ignore_errors=True)
            durable.rename(new, entry)


class GrowingColumn:
    """A .npy file to which rows are appended."""

    def __init__(self, file: IO[bytes], like: _Array) -> None:
        self._file = file
        self._header = np.lib.format.header_data_from_array_1_0(like[:0])
        self._rows = 0
        self._write_header()

    def append(self, rows: _Array) -> None:
        """Write the next rows."""
        self._file.write(rows.tobytes())
        self._rows += len(rows)

    def finish(self) -> None:
        """Write the number of rows into the header."""
        self._file.seek(0)
        self._write_header()

    def _write_header(self) -> None:
        shape = (self._rows, *self._header["shape"][1:])
        np.lib.format.write_array_header_1_0(self._file, self._header | {"shape": shape})


def _is_sound(entry: Path) -> bool:
    """Return whether an entry exists, its files have their hashes, and no file contains a pickle."""
    try:
        hashes = read_hashed(entry / _INDEX)
        if not hashes or any(hash_file(entry / name) != wanted for name, wanted in hashes.items()):
            return False
        for name in _list_columns(entry):
            _map_column(entry, name)
    except (OSError, ValueError, AttributeError):
        return False
    with contextlib.suppress(OSError):  # a read-only shared cache is still used
        os.utime(entry)
    return True


def _list_columns(entry: Path) -> list[str]:
    return [name.removesuffix(".npy") for name in read_hashed(entry / _INDEX) if name.endswith(".npy")]


def _map_column(entry: Path, name: str) -> _Array:
    """Return a memory-mapped column of an entry; rows that are not read take no memory."""
    return disk_arrays.map_file(entry / f"{name}.npy")


def _read_texts(entry: Path) -> dict[str, list[str]]:
    texts: dict[str, list[str]] = json.loads((entry / _TEXTS).read_text(encoding="utf-8"))
    return texts


def _map_truth(entry: Path) -> Trajectory | None:
    """Return the truth of an entry, memory-mapped, or None if its files contain no valid truth."""
    try:
        return _make_trajectory(
            {name: _map_column(entry, name) for name in _list_columns(entry)}, _read_texts(entry)
        )
    except (OSError, ValueError, KeyError, TypeError):
        return None


def _read_pieces(entry: Path) -> Iterator[Trajectory]:
    """Yield the truth of an entry in pieces; the last piece contains the events.

    The files are mapped again for each piece: a page once read stays in memory as long as its map lives.
    """
    names, texts = _list_columns(entry), _read_texts(entry)
    end = len(_map_column(entry, "t")) - 1
    used = dict.fromkeys(_PARTS, 0)
    for start in range(0, max(end, 1), PIECE):
        stop = min(start + PIECE, end)
        until = np.inf if stop == end else _map_column(entry, "t")[stop]
        ready = {
            part: int(np.searchsorted(_map_column(entry, f"{part}.t"), until, "right")) for part in _PARTS
        }
        ready["events"] = len(texts["kind"]) if stop == end else 0
        arrays = {}
        for name in names:
            part = name.rpartition(".")[0]
            own = part and name not in SHARED
            rows = slice(used[part], ready[part]) if own else slice(start, stop + (name in SHARED))
            arrays[name] = np.array(_map_column(entry, name)[rows])
        used = ready
        yield _make_trajectory(arrays, texts if stop == end else dict.fromkeys(_EVENT_TEXTS, ()))


def hash_file(path: Path) -> str:
    """Return the SHA-256 of a file."""
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()
