"""Read ``result.json`` of a results folder, and describe the damage of a damaged folder."""

from __future__ import annotations

import contextlib
import json
import re
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

from bench.core.files.file_checks import check_file, read_json
from bench.core.records.specs import EvaluationWindow
from bench.core.words.exceptions import BenchError, ConfigError
from bench.core.words.renames import check_format
from bench.io.results import parquet

"""Number of the layout of a results folder; a change that an older bench cannot read raises it."""

RESULT = "result.json"
TRUTH = "truth.parquet"
_MOST_BYTES = 100_000_000  # of it
SUMMARY = ("profile", "seed", "run", "metrics", "provenance")
"""Fields of a result in ``result.json``; its other entries are `RunResult.more`."""


def read_summary(folder: Path) -> dict[str, Any]:
    """Read ``result.json`` of a results folder, without the number of its format.

    Raises
    ------
    ConfigError
        If the folder is not a results folder of bench, or is one of a newer bench.
    """
    path = folder / RESULT
    try:
        check_file(path, str(path), _MOST_BYTES)
        summary: dict[str, Any] = json.loads(path.read_text(encoding="utf-8"))
        layout = summary.pop("format", 1)
        missing = [name for name in SUMMARY if name not in summary]
    except OSError as error:
        if folder.is_file():
            raise ConfigError(f"{folder}: is a file; name its folder, {folder.parent}") from None
        absent = isinstance(error, FileNotFoundError | NotADirectoryError)
        what = f"there is no {RESULT} in it" if absent else f"{RESULT}: {error.strerror}"
        raise ConfigError(f"{folder}: not a results folder, {what}; 'bench run' writes one") from None
    except (ValueError, TypeError, KeyError, AttributeError, RecursionError):
        raise ConfigError(f"{path}: not written by bench, or damaged") from None
    check_format({"format": layout}, str(path))
    if missing:
        raise ConfigError(f"{path}: not written by bench, it has no {missing[0]!r}")
    wrong = next(_find_wrong_entries(summary), None)
    if wrong is not None:
        raise ConfigError(f"{path}: not written by bench, or damaged: {wrong[0]} must be {wrong[1]}")
    return summary


_KINDS = {
    "reason": str,
    "unmodeled_errors": list,
    "same_as": str,
    "program": dict,
    "no_value": dict,
    "causes": list,
    "looks_like": list,
    "why_text": str,
}
"""Metric that is no number -> its type."""


def _find_wrong_entries(summary: Mapping[str, Any]) -> Iterator[tuple[str, str]]:
    """Yield the entries of ``result.json`` with a wrong type, and the type expected."""
    from bench.evaluation.metrics.run_metrics import find_metric  # not before there is one to check

    profile, metrics = summary["profile"], summary["metrics"]
    if not (isinstance(profile, dict) and isinstance(profile.get("title"), str)):
        yield "profile.title", "a text"
    evaluation = profile.get("evaluation", {}) if isinstance(profile, dict) else {}
    for name in (*EvaluationWindow.keys(), "output_hz"):
        if not (isinstance(evaluation, dict) and isinstance(evaluation.get(name), int | float)):
            yield f"profile.evaluation.{name}", "a number"
    scene = summary.get("scene", {})
    mask = scene.get("antenna_mask_deg") if isinstance(scene, dict) else "none"
    if not (mask is None or isinstance(mask, int | float)):
        yield "scene.antenna_mask_deg", "a number"
    for name in ("seed", "run"):
        if not isinstance(summary[name], int):
            yield name, "a whole number"
    by_label = isinstance(metrics, dict) and all(isinstance(values, dict) for values in metrics.values())
    for label, values in metrics.items() if by_label else ():
        for name, value in values.items():
            number = value is None or isinstance(value, int | float)
            if find_metric(name) is not None and not number:
                yield f"metrics.{label}.{name}", "a number"
        for name, kind in _KINDS.items():
            if values.get(name) is not None and not isinstance(values[name], kind):
                yield f"metrics.{label}.{name}", f"of type {kind.__name__}"
        if not isinstance(values.get("converged"), bool):
            yield f"metrics.{label}.converged", "true or false"
    if not by_label:
        yield "metrics", "a table for each filter"


@contextlib.contextmanager
def open_summary(folder: Path, name: str, what: str) -> Iterator[dict[str, Any]]:
    """Provide the JSON object of a campaign or a study; raise an error if its entries are not as expected.

    Raises
    ------
    ConfigError
        If there is no file ``name`` in the folder, which is then not that of a ``what``, or it is damaged.
    """
    path = folder / name
    if not path.exists():
        raise ConfigError(f"{folder}: no {what}, there is no {name} in it")
    try:
        yield read_json(path)
    except (LookupError, TypeError, ValueError, AttributeError, ArithmeticError):
        raise ConfigError(f"{path}: not written by this version of bench, or damaged") from None


@contextlib.contextmanager
def report_damage(folder: Path) -> Iterator[None]:
    """Convert exceptions from reading a damaged results folder to a ConfigError of one line."""
    try:
        yield
    except BenchError:
        raise
    except FileNotFoundError as error:
        missing = re.findall(r"[\w.-]+\.(?:parquet|json)", str(error.filename or error))
        what = missing[-1] if missing else "file"
        if what == TRUTH:
            raise ConfigError(f"{folder}: has no truth, because it comes from a log") from None
        raise ConfigError(f"{folder}: no {what} in it; 'bench run' writes a whole folder") from None
    except parquet.damages() as error:
        reason = " ".join(str(error).split())[:200]
        if isinstance(error, KeyError):
            reason = f"{reason} is missing"
        raise ConfigError(f"{folder}: cannot be read: {reason or type(error).__name__}") from None
