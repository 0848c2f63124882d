"""The journal of a campaign: the finished runs, appended by the driver alone.

A finished run is a line of `NAME`: a checksum, a space, and a JSON object with the ``key`` of the run. A line
whose checksum is wrong, such as the last one after a power cut, or that holds something else, counts as not
written. After `parts.ROWS` lines, a part gets their runs, and the lines begin anew. After ``kill -9`` every
finished run is kept; a power cut costs the runs of the last second.
"""

from __future__ import annotations

import hashlib
import json
import os
import time
from base64 import b64decode
from collections.abc import Collection, Iterable, Mapping
from pathlib import Path
from typing import Annotated, Any

from pydantic import AfterValidator, BaseModel, ConfigDict, Field

from bench.core.files import durable, file_checks
from bench.core.mathematics.arrays import IntArray
from bench.core.words.exceptions import ConfigError
from bench.evaluation.metrics.run_metrics import find_metric
from bench.experiments.campaigns import parts
from bench.experiments.campaigns.worker import CHANNELS
from bench.io import results
from bench.io.results.row_parts import split_key

NAME = "journal.jsonl"
"""Name of the journal in the folder of a campaign; its parts are beside it."""


def list_files(folder: Path) -> list[str]:
    """Return the names of the files of the journal in a folder."""
    return [NAME, *parts.list_parts(folder)]


_DIGITS = 16  # of the checksum
_LARGEST = 4_000_000_000  # journal: a thousand runs, each of 1 MB, and room [byte]
_MOST = 1e15  # no number of a run is larger
_UNSYNCED = 1.0  # longest time until a line is on the disk, if more come [s]


def _whole_instants(text: str) -> str:
    if len(b64decode(text, validate=True)) % (4 * len(CHANNELS)):
        raise ValueError("holds no whole rows")
    return text


def _sound_metrics(metrics: dict[str, Any]) -> dict[str, Any]:
    """Return metrics of a valid type and size; raise a ValueError for others."""
    wrong = [
        name
        for name, value in metrics.items()
        if not (value is None or (isinstance(value, int | float) and abs(value) < _MOST))
        and find_metric(name) is not None
    ]
    if wrong or not isinstance(metrics.get("converged"), bool):
        raise ValueError("are none")
    return metrics


class _JournalRow(BaseModel):
    model_config = ConfigDict(strict=True, extra="forbid", allow_inf_nan=False)


class _Estimated(_JournalRow):
    """Metrics of a filter in a run (`worker.measure`)."""

    metrics: Annotated[dict[str, float | int | bool | str | list[Any] | dict[str, Any] | None],
                       AfterValidator(_sound_metrics)]  # fmt: skip
    states: Annotated[int, Field(ge=0, le=_MOST)]
    nis_dof: dict[str, Annotated[int, Field(ge=0, le=_MOST)]]
    repetition: dict[str, list[float]]
    instants: Annotated[str, AfterValidator(_whole_instants)]


class _LostRow(_JournalRow):
    key: str
    error: str


class _Finished(_JournalRow):
    key: str
    step: Annotated[float, Field(gt=0, le=_MOST)]
    cpu_s: dict[str, float]
    estimator_cpu_s: dict[str, float]
    estimators: dict[str, _Estimated]


class Journal:
    """The finished runs of a campaign by key, with the rows on disk; leaving the context closes the file.

    If a run has several rows, the last one counts.

    Raises
    ------
    ConfigError
        If the journal is a link, a pipe or a device, or larger than 4 GB.
    """

    def __init__(self, path: Path) -> None:
        self._path = path
        self._places: dict[str, tuple[int, int]] = {}  # of the lines
        self._failed: set[str] = set()  # keys of lines with a reason instead of results
        self._end = 0  # of the last whole line
        self._synced = time.monotonic()
        self._parts = parts.Parts(path.parent, _check)
        self.damaged = self._parts.damaged  # lines and parts that do not count
        if path.is_symlink():
            raise ConfigError(f"{path}: is a link; put the journal itself there")
        if path.exists():
            file_checks.check_file(path, str(path), _LARGEST)
        self._descriptor = os.open(path, os.O_RDWR | os.O_CREAT | getattr(os, "O_BINARY", 0), 0o666)
        with path.open("rb") as file:
            for line in file:
                if not line.endswith(b"\n"):  # it was being written when the driver ended
                    break
                row = _parse(line)
                if row is None:
                    self.damaged += 1
                else:
                    self._note(row, len(line))
                self._end += len(line)
        if self._places and self._places.keys() == self._parts.list_last():  # the part was just written
            self._begin_anew()
        os.ftruncate(self._descriptor, self._end)

    def __enter__(self) -> Journal:
        return self

    def __exit__(self, *error: object) -> None:
        try:
            durable.append(self._descriptor, b"", self._end, self._path)
        finally:
            os.close(self._descriptor)

    def find_labels(self) -> tuple[str, ...]:
        """Return the filters of the first run that did not fail completely."""
        rows = (self[key] for key in self._places)
        found = self._parts.labels
        return found or next((tuple(row["estimators"]) for row in rows if "estimators" in row), ())

    def find_missing(self, planned: Iterable[tuple[str, IntArray]]) -> list[IntArray]:
        """Return for each cell and the numbers of its runs those without a row, or that failed as a whole."""
        lines: dict[str, dict[int, bool]] = {}
        for key in self._places:
            cell, run = split_key(key)
            lines.setdefault(cell, {})[run] = key in self._failed
        missing = []
        for cell, runs in planned:
            found = self._parts.find_finished(cell, runs)
            for run, failed in lines.get(cell, {}).items():
                found[runs == run] = not failed
            missing.append(runs[~found])
        return missing

    def __contains__(self, key: object) -> bool:
        return key in self._places or key in self._parts

    def __getitem__(self, key: str) -> dict[str, Any]:
        """Return the row of a run; ConfigError if it is in a part that is damaged."""
        if key not in self._places:
            return self._parts[key]
        row = self._read(key)
        if row is None:
            raise OSError(0, "damaged while it was in use", str(self._path))
        return row

    def _read(self, key: str) -> dict[str, Any] | None:
        start, length = self._places[key]
        return _parse(durable.read_at(self._descriptor, length, start))

    def keep_runs_of(self, labels: Collection[str]) -> None:
        """Forget the runs of other estimators."""
        self.damaged += self._parts.keep_runs_of(frozenset(labels))
        for key in list(self._places):
            found = self[key].get("estimators")
            if found is not None and found.keys() != set(labels):
                del self._places[key]
                self.damaged += 1

    def append(self, row: Mapping[str, Any]) -> None:
        """Write a row with its ``key``; after a second or as a part it is on the disk.

        Raises
        ------
        OSError
            If it cannot be written; what was written before is kept.
        """
        text = json.dumps(row, allow_nan=False, separators=(",", ":")).encode()
        line = sum_text(text) + b" " + text + b"\n"
        late = time.monotonic() - self._synced > _UNSYNCED
        try:
            durable.append(self._descriptor, line, self._end, self._path, sync=late)
            self._synced = time.monotonic() if late else self._synced
            self._note(row, len(line))
            self._end += len(line)
            if len(self._places) >= parts.ROWS:
                self._close_part()
        except OSError as error:
            why = f"{error.strerror}; what is finished is kept, --resume continues"
            raise OSError(error.errno, why, str(self._path)) from error

    def _note(self, row: Mapping[str, Any], length: int) -> None:
        """Note the place of the row of a line."""
        key = str(row["key"])
        self._places[key] = (self._end, length)
        (self._failed.add if "error" in row else self._failed.discard)(key)

    def _close_part(self) -> None:
        """Write the runs of the lines as parts, and begin the lines anew."""
        rows = [row for key in self._places if (row := self._read(key)) is not None]
        for begin in range(0, len(rows), parts.ROWS):
            self._parts.write(
                rows[begin : begin + parts.ROWS], lambda name: results.add_to_mark(self._path.parent, name)
            )
        self._begin_anew()

    def _begin_anew(self) -> None:
        self._places, self._failed, self._end = {}, set(), 0
        os.ftruncate(self._descriptor, 0)


def sum_text(text: bytes) -> bytes:
    """Return the checksum of a line's text."""
    return hashlib.sha256(text).hexdigest()[:_DIGITS].encode()


def _parse(line: bytes) -> dict[str, Any] | None:
    """Return the row of a line, or None if the line is damaged."""
    checksum, _, text = line.rstrip(b"\n").partition(b" ")
    if checksum != sum_text(text):
        return None
    try:
        row = json.loads(text)
        _check(row)
    except (ValueError, TypeError, RecursionError):
        return None
    return dict(row)


def _check(row: dict[str, Any]) -> None:
    """Raise ValueError for a row that no run writes."""
    (_LostRow if "error" in row else _Finished).model_validate(row)
