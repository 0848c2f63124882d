"""Truth is flown once: by content hash, written atomically, read memory-mapped, nothing unpickled."""

from __future__ import annotations

import contextlib
import dataclasses
import hashlib
import json
import logging
import os
import shutil
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from bench.data import AirData, Controls, Events, Trajectory
from bench.places import PACKAGE, cache_folder
from bench.specs import FlightSpec
from bench.store.provenance import versions

_UNUSED_DAYS = 30
_LOG = logging.getLogger(__name__)

_INDEX = "index.json"  # SHA-256 of every other file of an entry
_TEXTS = "texts.json"
_PARTS = ("air", "controls", "events")
_SOURCES = ("flight", "rotation.py", "earth.py", "arrays.py", "data.py", "specs.py")
"""Files of the package that truth depends on."""


def truth_cached(spec: FlightSpec, fly: Callable[[], Trajectory]) -> Trajectory:
    """Return the truth of a flight: from the cache, or flown and kept there.

    Parameters
    ----------
    spec : FlightSpec
        All that the truth depends on, besides the aircraft's files and the software.
    fly : callable
        Flies it. Called when the cache has no such truth, or a damaged one.

    Returns
    -------
    truth : Trajectory
        Bit-identical to what ``fly`` returns; its columns are mapped from the cache's files.
    """
    entry = cache_folder("truth") / truth_key(spec)
    truth = _read(entry)
    if truth is not None:
        return truth
    truth = fly()
    try:
        _write(entry, truth)
        _remove_unused(entry.parent)
    except OSError as error:  # no room, no right to write: the truth is as good without
        _LOG.warning("truth is not cached in %s: %s", entry.parent, error.strerror or error)
    return truth


def truth_key(spec: FlightSpec) -> str:
    """Return the hash of everything truth depends on: the flight, the aircraft's files, the software."""
    values = dataclasses.asdict(spec)
    aircraft = values["aircraft"]
    folder, systems = Path(aircraft.pop("folder")), Path(aircraft.pop("systems"))
    legs = [[type(leg).__name__, dataclasses.asdict(leg)] for leg in spec.legs]
    digest = hashlib.sha256()
    digest.update(json.dumps({**values, "legs": legs, "versions": versions()}, sort_keys=True).encode())
    for root in (folder, systems, *(PACKAGE / name for name in _SOURCES)):
        for path in _files(root):
            digest.update(f"{root.name}/{path.relative_to(root)}\0{path.stat().st_size}\0".encode())
            digest.update(path.read_bytes())
    return digest.hexdigest()[:32]


def _files(root: Path) -> list[Path]:
    if root.is_file():
        return [root]
    return sorted(p for p in root.rglob("*") if p.is_file() and p.suffix not in (".pyc", ".md"))


def _arrays(truth: Trajectory) -> dict[str, np.ndarray[Any, Any]]:
    """Return every numeric column of a trajectory by its name: ``lla``, ``air.t`` ..."""
    parts: dict[str, Any] = {"": truth} | {part: getattr(truth, part) for part in _PARTS}
    return {
        f"{part}.{field.name}".lstrip("."): getattr(record, field.name)
        for part, record in parts.items()
        for field in dataclasses.fields(record)
        if isinstance(getattr(record, field.name), np.ndarray)
    }


def _write(entry: Path, truth: Trajectory) -> None:
    entry.parent.mkdir(parents=True, exist_ok=True)
    scratch = Path(tempfile.mkdtemp(prefix=".new-", dir=entry.parent))
    try:
        for name, array in _arrays(truth).items():
            np.save(scratch / f"{name}.npy", array, allow_pickle=False)
        texts = {"kind": truth.events.kind, "text": truth.events.text}
        (scratch / _TEXTS).write_text(json.dumps(texts), encoding="utf-8")
        hashes = {path.name: _sha256(path) for path in scratch.iterdir()}
        (scratch / _INDEX).write_text(json.dumps(hashes), encoding="utf-8")
        shutil.rmtree(entry, ignore_errors=True)  # damaged, or another process was as fast
        scratch.rename(entry)
    except BaseException:
        shutil.rmtree(scratch, ignore_errors=True)
        raise


def _read(entry: Path) -> Trajectory | None:
    """Return the truth of a cache entry, or None when it is absent or damaged."""
    try:
        hashes = json.loads((entry / _INDEX).read_text(encoding="utf-8"))
        if any(_sha256(entry / name) != wanted for name, wanted in hashes.items()):
            return None
        rows: dict[str, dict[str, Any]] = {part: {} for part in ("", *_PARTS)}
        for file in hashes.keys() - {_TEXTS}:
            part, _, name = file.removesuffix(".npy").rpartition(".")
            rows[part][name] = np.load(entry / file, mmap_mode="r", allow_pickle=False)
        texts = json.loads((entry / _TEXTS).read_text(encoding="utf-8"))
        events = Events(**rows["events"], kind=tuple(texts["kind"]), text=tuple(texts["text"]))
        air, controls = AirData(**rows["air"]), Controls(**rows["controls"])
        truth = Trajectory(**rows[""], air=air, controls=controls, events=events)
    except (OSError, ValueError, KeyError, TypeError, AttributeError):
        return None
    with contextlib.suppress(OSError):  # a cache shared read-only still serves
        os.utime(entry)
    return truth


def _sha256(path: Path) -> str:
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def _remove_unused(root: Path) -> None:
    """Remove entries that no run has read for 30 days."""
    oldest = time.time() - _UNUSED_DAYS * 86400
    for entry in root.iterdir():
        if entry.stat().st_mtime < oldest:
            shutil.rmtree(entry, ignore_errors=True)
