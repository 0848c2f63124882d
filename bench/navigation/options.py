"""What an option of an estimator, a value of TOML, may be."""

from __future__ import annotations

from typing import TypeGuard


def is_number(value: object) -> TypeGuard[float]:
    """Say whether a value is a number; true and false are none.

    Examples
    --------
    >>> is_number(2), is_number(0.5), is_number(True), is_number("2")
    (True, True, False, False)
    """
    return isinstance(value, int | float) and not isinstance(value, bool)


def is_count(value: object) -> bool:
    """Say whether a value is a whole number, 1 or more.

    Examples
    --------
    >>> is_count(2), is_count(3.0), is_count(0), is_count(1.5), is_count(float("inf")), is_count(True)
    (True, True, False, False, False, False)
    """
    return is_number(value) and float(value).is_integer() and value >= 1
