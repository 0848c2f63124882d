"""File with the state of a filter that runs in pieces: exact numbers, no code, a checksum."""

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
from bench.core.files import durable
from bench.core.files.file_checks import check_file
from bench.core.records.specs import EstimatorChoice
from bench.core.words.exceptions import EstimatorError
from bench.core.words.wording import one_line
from bench.io.foreign.loading import load_estimators
from bench.io.results.start_document import assumed_document, read_assumed_specs
from bench.navigation.open_filters import PieceFilter

FORMAT = 3
_MOST_BYTES = 2_000_000_000
_NOTES, _SUM = "notes", "sha256"


def write_filter(filter_: PieceFilter, path: str | os.PathLike[str]) -> Path:
    """Write the state of a filter to a file, completely or not at all.

    Parameters
    ----------
    filter_ : PieceFilter
        Filter from `bench.open_filter` after at least one update.
    path : str or Path
        File to write; `read_filter` reads it.

    Returns
    -------
    Path
        The file.

    Raises
    ------
    bench.EstimatorError
        If the filter has not been updated yet.
    OSError
        If the file cannot be written; an existing file is left unchanged.

    Examples
    --------
    >>> import bench, tempfile
    >>> sensed = bench.sense("approach", bench.fly("approach"))
    >>> live = bench.open_filter("loose-15", sensed.initial)
    >>> rows = live.update(bench.slice_sensors(sensed.data, float("-inf"), 10.0))
    >>> with tempfile.TemporaryDirectory() as place:
    ...     bench.write_filter(live, place + "/filter.npz").name
    'filter.npz'
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
    arrays[_SUM] = np.array(hash_arrays(arrays))
    memory = io.BytesIO()
    np.savez(memory, **arrays)
    durable.write(place, memory.getvalue())
    return place


def read_filter(path: str | os.PathLike[str], *, allow_code: bool = False) -> PieceFilter:
    """Read a filter that `write_filter` wrote; it continues as if it had never stopped.

    The file contains data only. Names, shapes and types are checked against the same filter before its first
    update, and so is every value that compiled code uses as an index.

    Parameters
    ----------
    path : str or Path
        File of the filter.
    allow_code : bool, optional
        Import the class that the file names, if it is not built in. Default: no.

    Returns
    -------
    PieceFilter
        The filter, as `bench.open_filter` returns it.

    Raises
    ------
    bench.EstimatorError
        If the file is damaged, contains no filter, was written by another version of bench, or names code
        that is not permitted.
    FileNotFoundError
        If there is no such file.

    Examples
    --------
    >>> import bench, tempfile
    >>> sensed = bench.sense("approach", bench.fly("approach"))
    >>> live = bench.open_filter("loose-15", sensed.initial)
    >>> rows = live.update(bench.slice_sensors(sensed.data, float("-inf"), 10.0))
    >>> with tempfile.TemporaryDirectory() as place:
    ...     again = bench.read_filter(bench.write_filter(live, place + "/filter.npz"))
    >>> bool((again.current().cov == live.current().cov).all())
    True
    """
    what = f"{path} holds no filter that bench saved"
    check_file(Path(path), str(path), _MOST_BYTES)
    try:
        arrays = _read_arrays(Path(path))
        total = str(arrays.pop(_SUM))
        notes = json.loads(str(arrays[_NOTES]))
        made, known, use, options = (notes[name] for name in ("bench", "format", "use", "options"))
    except Exception as error:  # nothing but the file is read here
        raise EstimatorError(f"{what}: {one_line(str(error))[:200]}") from error
    if total != hash_arrays(arrays):
        raise EstimatorError(f"{what}: it has been changed or damaged; save it again")
    if known != FORMAT:
        raise EstimatorError(
            f"{path} has format {known} of a saved filter, this bench reads format {FORMAT}: "
            "run the record again"
        )
    if made != bench.__version__:
        raise EstimatorError(
            f"{path} was saved by bench {made}; its numbers may mean something else to {bench.__version__}: "
            "run the record again"
        )
    if ":" in str(use) and not allow_code:
        raise EstimatorError(
            f"{path}: names {str(use)[:60]!r}, which runs code on this machine; allow_code=True permits it"
        )
    del arrays[_NOTES]
    try:
        specs, state = read_assumed_specs(notes), _give_arrays(notes["state"], arrays)
        if arrays:
            raise ValueError(f"{next(iter(arrays))} belongs to nothing")
        built = load_estimators([EstimatorChoice(use, use, options)])[0]
        return PieceFilter.resume(use, options, built, specs, state, str(path))
    except Exception as error:  # what is restored is made of nothing but the file
        raise EstimatorError(
            f"{path}: its state is none of {use!r} with these options: {one_line(str(error))[:300]}"
        ) from error


def _read_arrays(path: Path) -> dict[str, Any]:
    """Read the arrays of a file; reject compressed arrays, which bench never writes."""
    with zipfile.ZipFile(path) as archive:
        if any(one.compress_type != zipfile.ZIP_STORED for one in archive.infolist()):
            raise ValueError("it is compressed")
    with np.load(path, allow_pickle=False) as found:
        return {name: found[name] for name in found.files}


def _take_arrays(value: Any, name: str, arrays: dict[str, Any]) -> Any:
    """Return a value with its arrays replaced by names, and store the arrays separately."""
    if isinstance(value, np.ndarray):
        arrays[name] = value
        return {"array": name}
    if isinstance(value, Mapping):
        return {key: _take_arrays(inner, f"{name}/{key}", arrays) for key, inner in value.items()}
    if isinstance(value, list):
        return [_take_arrays(inner, f"{name}/{k}", arrays) for k, inner in enumerate(value)]
    return value


def _give_arrays(value: Any, arrays: dict[str, Any]) -> Any:
    """Undo :func:`_take_arrays`; each array is used exactly once."""
    if isinstance(value, Mapping):
        if value.keys() == {"array"}:
            if value["array"] not in arrays:
                raise ValueError(f"{value['array']} is missing")
            return arrays.pop(value["array"])
        return {key: _give_arrays(inner, arrays) for key, inner in value.items()}
    if isinstance(value, list):
        return [_give_arrays(inner, arrays) for inner in value]
    return value


def hash_arrays(arrays: Mapping[str, Any]) -> str:
    """Return the checksum of arrays, with their names, types and shapes."""
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
