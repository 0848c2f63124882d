"""The journal of a campaign: one line for each finished run, appended by the driver alone.

A line is a checksum, a space, and a JSON object with the ``key`` of the run. A line whose checksum is wrong,
such as the last one after a power cut, or that holds something else, counts as not written.
"""

from __future__ import annotations

import hashlib
import json
import os
from base64 import b64decode
from collections.abc import Collection, Mapping
from pathlib import Path
from typing import Annotated, Any

from pydantic import AfterValidator, BaseModel, ConfigDict, Field

from bench.core.files import durable
from bench.evaluation.metrics.run_metrics import find_metric
from bench.experiments.campaigns.worker import CHANNELS

NAME = "journal.jsonl"
"""Name of the journal in the folder of a campaign."""

_DIGITS = 16  # of the checksum
_MOST = 1e15  # no number of a run is larger


def _whole_instants(text: str) -> str:
    if len(b64decode(text, validate=True)) % (4 * len(CHANNELS)):
        raise ValueError("holds no whole rows")
    return text


def _sound_metrics(metrics: dict[str, Any]) -> dict[str, Any]:
    """Return metrics of a valid type and size; raise a ValueError for others."""
    wrong = [
        name
        for name, value in metrics.items()
        if find_metric(name) is not None
        and not (value is None or (isinstance(value, int | float) and abs(value) < _MOST))
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

    If a run has several lines, the last one counts.
    """

    def __init__(self, path: Path) -> None:
        self._path = path
        self._places: dict[str, tuple[int, int]] = {}
        self._end = 0  # of the last whole line
        self.damaged = 0  # lines that do not count
        self._descriptor = os.open(path, os.O_RDWR | os.O_CREAT | getattr(os, "O_BINARY", 0), 0o666)
        with path.open("rb") as file:
            for line in file:
                if not line.endswith(b"\n"):  # it was being written when the driver ended
                    break
                row = _parse(line)
                if row is None:
                    self.damaged += 1
                else:
                    self._places[row["key"]] = (self._end, len(line))
                self._end += len(line)
        os.ftruncate(self._descriptor, self._end)

    def __enter__(self) -> Journal:
        return self

    def __exit__(self, *error: object) -> None:
        os.close(self._descriptor)

    def find_labels(self) -> tuple[str, ...]:
        """Return the filters of the first run that did not fail completely."""
        rows = (self[key] for key in self._places)
        return next((tuple(row["estimators"]) for row in rows if "estimators" in row), ())

    def __contains__(self, key: object) -> bool:
        return key in self._places

    def __getitem__(self, key: str) -> dict[str, Any]:
        start, length = self._places[key]
        row = _parse(durable.read_at(self._descriptor, length, start))
        if row is None:
            raise OSError(0, "damaged while it was in use", str(self._path))
        return row

    def keep_runs_of(self, labels: Collection[str]) -> None:
        """Forget the runs of other estimators."""
        for key in list(self._places):
            found = self[key].get("estimators")
            if found is not None and found.keys() != set(labels):
                del self._places[key]
                self.damaged += 1

    def append(self, row: Mapping[str, Any]) -> None:
        """Write a row with its ``key``, and wait until it is on the disk.

        Raises
        ------
        OSError
            If it cannot be written; what was written before is kept.
        """
        text = json.dumps(row, allow_nan=False, separators=(",", ":")).encode()
        line = sum_text(text) + b" " + text + b"\n"
        try:
            durable.append(self._descriptor, line, self._end, self._path)
        except OSError as error:
            why = f"{error.strerror}; what is finished is kept, --resume continues"
            raise OSError(error.errno, why, str(self._path)) from error
        self._places[str(row["key"])] = (self._end, len(line))
        self._end += len(line)


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
        (_LostRow if "error" in row else _Finished).model_validate(row)
    except (ValueError, TypeError, RecursionError):
        return None
    return dict(row)
