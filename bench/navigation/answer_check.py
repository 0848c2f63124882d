"""Check of the solution of a filter from user code, the only place where it enters bench."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import fields
from typing import Any, TypeVar

import numpy as np

from bench.core.files import disk_arrays
from bench.core.mathematics.arrays import FloatArray
from bench.core.records.data import STATES, Events, Innovations, NavSolution
from bench.core.records.fields import Record, columns_of
from bench.core.words.wording import one_line

_Kind = TypeVar("_Kind", bound=Record)

LARGEST = 1e150
"""A finite number beyond it is rejected: its square is none."""

_PARTS: dict[str, type[Record]] = {"innovations": Innovations, "events": Events}
_POLE = 0.5 * np.pi * (1.0 + 1e-12)  # latitude [rad]
_ROUNDING, _ASYMMETRY = 1e-9, 1e-5
"""Difference of two elements that should be equal, over the product of their sigmas: none; too much."""
_LONGEST = 200  # characters of an error in a message


def check_solution(found: object) -> NavSolution:
    """Return a checked solution as a `NavSolution` with symmetric covariances.

    NaN, infinite values and infinite variances stay: a state that is not estimated is NaN, and a diverged
    filter is a result. All bits are returned unchanged, except for covariances with two triangles that differ
    by more than rounding: both get the mean.

    Raises
    ------
    ValueError
        If it is no solution: a field of another type or shape, a latitude beyond 90 deg, a finite number
        beyond :data:`LARGEST`, or a covariance that is not symmetric; the message says which.
    """
    if not isinstance(found, NavSolution):
        raise ValueError(f"run() must return a NavSolution; got {type(found).__name__}")
    for name, kind in _PARTS.items():
        part = getattr(found, name, None)
        if not isinstance(part, kind):
            raise ValueError(f"{name} must be {kind.__name__}; got {type(part).__name__}")
    parts = {name: _rebuild(kind, name, getattr(found, name)) for name, kind in _PARTS.items()}
    solution = _rebuild(NavSolution, "", found, **parts)
    _check_codes(solution.innovations)
    names = solution.extra_names
    if twice := [name for k, name in enumerate(names) if name in names[:k]]:
        raise ValueError(f"extra_names has {twice[0]!r} twice; each names a column")
    beyond = np.abs(solution.lla[:, 0]) > _POLE
    beyond &= np.isfinite(solution.lla[:, 0])
    if beyond.any():
        lat = np.degrees(solution.lla[beyond, 0][0])
        raise ValueError(
            f"its latitude is {lat:.6g} deg at t = {solution.t[beyond][0]:g} s; "
            "lla is latitude, longitude [rad], height [m]"
        )
    symmetric = _make_symmetric(solution)
    return solution if symmetric is None else _rebuild(NavSolution, "", solution, cov=symmetric)


def _rebuild(kind: type[_Kind], place: str, given: Any, **changed: Any) -> _Kind:
    """Return a copy of a record, made from its fields after a check of columns and names."""
    try:
        values = {one.name: getattr(given, one.name) for one in fields(kind)} | changed
        for name in _list_texts(kind):
            values[name] = _check_texts(f"{place}.{name}" if place else name, values[name])
        for name, one in columns_of(kind).items():
            if one.kind is not str:
                _check_type(f"{kind.__name__}.{name}", values[name], one.kind)
        record = kind(**values)
    except Exception as error:  # whatever an array of others raises when it is looked at
        said = str(error) or type(error).__name__
        where = "" if said.startswith((kind.__name__, place or " ", "extra_names")) else f"{kind.__name__}: "
        raise ValueError(one_line(f"{where}{said}")[:_LONGEST]) from None
    for name, one in columns_of(kind).items():
        if one.kind is float:
            _check_size(f"{kind.__name__}.{name}", getattr(record, name))
    return record


def _list_texts(kind: type[Record]) -> Iterator[str]:
    """Yield the names of the fields of a record that contain words."""
    declared = columns_of(kind)
    for one in fields(kind):
        if declared[one.name].kind is str if one.name in declared else one.type == "tuple[str, ...]":
            yield one.name


def _check_texts(place: str, value: Any) -> tuple[str, ...]:
    if not isinstance(value, tuple | list):
        raise TypeError(f"{place} must be a tuple of texts; got {type(value).__name__}")
    for k, text in enumerate(value):
        if not isinstance(text, str):
            raise TypeError(f"{place}[{k}] must be a text; got {type(text).__name__}")
        try:
            text.encode()
        except UnicodeEncodeError:
            raise ValueError(f"{place}[{k}] = {text!a} contains an invalid character") from None
    return tuple(map(str, value))


def _check_type(place: str, column: Any, kind: type) -> None:
    """Check that a column still has the type of a new record."""
    if not isinstance(column, np.ndarray) or column.dtype != kind:
        of = f"an array of {column.dtype}" if isinstance(column, np.ndarray) else type(column).__name__
        raise TypeError(f"{place} must be an array of {kind.__name__}; got {of}")


def _check_size(place: str, column: FloatArray) -> None:
    for rows in disk_arrays.blocks(len(column)):
        large = np.abs(column[rows]) > LARGEST
        if large.any() and (large := large & np.isfinite(column[rows])).any():
            value, row = column[rows][large][0], rows.start + int(np.argwhere(large)[0][0])
            raise ValueError(
                f"{place} is {value:.3g} in row {row}; up to {LARGEST:g} can be evaluated, NaN is not known"
            )


def _check_codes(innovations: Innovations) -> None:
    count = len(innovations.sensor)
    wrong = (innovations.code < 0) | (innovations.code >= count)
    if wrong.any():
        code = innovations.code[wrong][0]
        raise ValueError(
            f"innovations.code is {code}; it is an index into the {count} names of innovations.sensor"
        )


def _make_symmetric(solution: NavSolution) -> FloatArray | None:
    """Return symmetric covariances, the mean of both triangles; None if the triangles agree."""
    cov, same = solution.cov, True
    for rows in disk_arrays.blocks(len(cov)):
        P = cov[rows]
        with np.errstate(invalid="ignore"):
            apart = np.abs(P - P.transpose(0, 2, 1))
            if not (apart > 0.0).any():
                continue
            sd = np.sqrt(np.abs(np.einsum("kii->ki", P)))
            scale = sd[:, :, None] * sd[:, None, :]
            same &= not (apart > _ROUNDING * scale).any()
            wrong = apart > _ASYMMETRY * scale
        if wrong.any():
            k, i, j = np.argwhere(wrong)[0]
            one, other = STATES[i][0], STATES[j][0]
            raise ValueError(
                f"cov is not symmetric at t = {solution.t[rows][k]:g} s: {one} with {other} "
                f"{P[k, i, j]:.3g}, {other} with {one} {P[k, j, i]:.3g}"
            )
    if same:
        return None
    return disk_arrays.fill(cov.shape, lambda rows: 0.5 * cov[rows] + 0.5 * cov[rows].transpose(0, 2, 1))
