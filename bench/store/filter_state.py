"""A file with the state of a filter that runs in pieces: numbers as they are, no code, a sum over all."""

from __future__ import annotations

import hashlib
import io
import json
import os
import zipfile
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

import bench
from bench.errors import EstimatorError
from bench.exchange.loading import load_estimators
from bench.navigation.open_filters import PieceFilter
from bench.specs import EstimatorChoice
from bench.store.start_document import assumed_document, read_assumed_specs

FORMAT = 1
_NOTES, _SUM = "notes", "sha256"


def save_filter(filter_: PieceFilter, path: str | os.PathLike[str]) -> Path:
    """Write the state of a filter to a file, whole or not at all; :func:`resume_filter` goes on with it.

    Raises
    ------
    EstimatorError
        If it has been given no piece.
    OSError
        If the file cannot be written; an existing file is left unchanged.
    """
    state, place = filter_.state(), Path(path)
    arrays: dict[str, Any] = {}
    assert filter_.head is not None
    notes = {
        "format": FORMAT,
        "bench": bench.__version__,
        "use": filter_.use,
        "options": filter_.options,
        "assumed": assumed_document(filter_.head.specs),
        "state": _take_arrays(state, "", arrays),
    }
    arrays[_NOTES] = np.array(json.dumps(notes, default=_to_plain))
    arrays[_SUM] = np.array(_sum(arrays))
    memory = io.BytesIO()
    np.savez(memory, **arrays)
    part = place.with_name(f".{place.name}.{os.getpid()}")
    try:
        part.write_bytes(memory.getvalue())
        part.replace(place)
    finally:
        part.unlink(missing_ok=True)
    return place


def resume_filter(path: str | os.PathLike[str]) -> PieceFilter:
    """Return the filter that :func:`save_filter` wrote: it goes on as if it had never stopped.

    Raises
    ------
    EstimatorError
        If the file is damaged, holds no filter, or is of another version of bench.
    FileNotFoundError
        If there is no such file.
    """
    what = f"{path} holds no filter that bench saved"
    with open(path, "rb") as file:
        content = io.BytesIO(file.read())
    try:
        with np.load(content, allow_pickle=False) as found:
            arrays = {name: found[name] for name in found.files}
        total = str(arrays.pop(_SUM))
        notes = json.loads(str(arrays[_NOTES]))
        made, known = notes["bench"], notes["format"]
    except (ValueError, KeyError, TypeError, OSError, EOFError, zipfile.BadZipFile) as error:
        raise EstimatorError(f"{what}: {error}") from error
    if total != _sum(arrays):
        raise EstimatorError(f"{what}: it has been changed or damaged; save it again")
    if (known, made) != (FORMAT, bench.__version__):
        raise EstimatorError(
            f"{path} was saved by bench {made}; its numbers may mean something else to {bench.__version__}: "
            "run the record again"
        )
    specs = read_assumed_specs(notes)
    built = load_estimators([EstimatorChoice(notes["use"], notes["use"], notes["options"])])[0]
    state = _give_arrays(notes["state"], arrays)
    return PieceFilter.restore(notes["use"], notes["options"], built, specs, state)


def _take_arrays(value: Any, name: str, arrays: dict[str, Any]) -> Any:
    """Return a value with its arrays put aside and named instead."""
    if isinstance(value, np.ndarray):
        arrays[name] = value
        return {"array": name}
    if isinstance(value, Mapping):
        return {key: _take_arrays(inner, f"{name}/{key}", arrays) for key, inner in value.items()}
    if isinstance(value, list):
        return [_take_arrays(inner, f"{name}/{k}", arrays) for k, inner in enumerate(value)]
    return value


def _give_arrays(value: Any, arrays: Mapping[str, Any]) -> Any:
    """Undo :func:`_take_arrays`."""
    if isinstance(value, Mapping):
        if value.keys() == {"array"}:
            return arrays[value["array"]]
        return {key: _give_arrays(inner, arrays) for key, inner in value.items()}
    if isinstance(value, list):
        return [_give_arrays(inner, arrays) for inner in value]
    return value


def _sum(arrays: Mapping[str, Any]) -> str:
    digest = hashlib.sha256()
    for name in sorted(arrays):
        one = arrays[name]
        digest.update(f"{name} {one.dtype} {one.shape}\n".encode())
        digest.update(np.ascontiguousarray(one).tobytes())
    return digest.hexdigest()


def _to_plain(value: Any) -> Any:
    if isinstance(value, np.generic):
        return value.item()
    return str(value)
