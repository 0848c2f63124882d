"""Rounded digests of data: equal on every processor and library version, different for other runs."""

from __future__ import annotations

import hashlib
from collections.abc import Iterator
from dataclasses import fields, is_dataclass
from typing import Any

import numpy as np

from bench.core.mathematics.arrays import FloatArray

DIGITS = 5
"""Digits of the figures of a column that its digest holds."""

_NO_DATA = ("specs", "fix_cov")  # what filters assume, and what an alignment finds

_ROUND_OFF = 1e-9  # a spread below this fraction of the values may be round-off


def digest_record(record: Any) -> str:
    """Return a digest of all numbers of a record or a list of records, and of the records in them.

    Of each column it holds the number of rows and of finite values, and mean, standard deviation and standard
    deviation of the differences between rows, rounded to `DIGITS` digits. Another processor moves the last of
    sixteen digits, which leaves the digest the same. Other noise, even of one sensor, changes it.
    """
    text = "\n".join(f"{name} {line}" for name, line in _describe(record, ""))
    return hashlib.sha256(text.encode()).hexdigest()[:16]


def _describe(value: Any, name: str) -> Iterator[tuple[str, str]]:
    if is_dataclass(value):
        for field in fields(value):
            if field.name not in _NO_DATA:
                yield from _describe(getattr(value, field.name), f"{name}.{field.name}")
    elif isinstance(value, list):
        for k, item in enumerate(value):
            yield from _describe(item, f"{name}.{k}")
    elif isinstance(value, np.ndarray) and value.dtype.kind in "fiub" and value.size:
        columns = np.asarray(value, np.float64).reshape(len(value), -1)
        for k, column in enumerate(columns.T):
            yield f"{name}.{k}", _describe_column(column)
    elif isinstance(value, int | float):
        yield name, f"{value:.{DIGITS}g}"


def _describe_column(column: FloatArray) -> str:
    good = column[np.isfinite(column)]
    if not len(good):
        return f"{len(column)} 0"
    size = float(np.abs(good).max())
    mean, spread, step = (
        float(good.mean()),
        float(good.std()),
        float(np.diff(good).std() if len(good) > 1 else 0),
    )
    scale = size if spread < _ROUND_OFF * size else spread
    rounded = round(mean / scale, DIGITS) + 0.0 if scale else 0.0
    kept = [f"{x:.{DIGITS - 1}e}" if x > _ROUND_OFF * size else "0" for x in (spread, step)]
    return f"{len(column)} {len(good)} {rounded:g} {' '.join(kept)}"
