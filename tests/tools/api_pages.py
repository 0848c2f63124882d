"""The pages of the Python API: one a topic, from the docstrings."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from typing import Any

TOPICS: Mapping[str, tuple[str, tuple[str, ...]]] = {
    "api-run": ("Run a flight", ("run", "fly", "sense", "evaluate", "read_profile", "serve")),
    "api-log": ("Evaluate recorded data", ("navigate", "read_log", "solve_rinex", "measure_allan")),
    "api-filter": (
        "Run and write filters",
        ("run_filter", "open_filter", "slice_sensors", "read_filter", "write_filter", "Estimator",
         "check_estimator", "fix_steps", "track_solution", "Guard"),
    ),
    "api-result": (
        "Read, write and compare results",
        ("read_result", "write_result", "to_arrow", "compare_results", "write_report", "export_run",
         "score_solution", "stream_run", "convert_unit"),
    ),
    "api-experiment": (
        "Campaigns, studies, cards and baselines",
        ("campaign", "read_campaign", "study", "read_study", "tune", "make_card", "read_card",
        "compare_cards",
         "check"),
    ),
    "api-list": (
        "List what is available",
        ("list_profiles", "list_aircraft", "list_sensors", "list_estimators", "list_studies", "list_metrics"),
    ),
    "api-record": (
        "Records",
        ("Profile", "Trajectory", "Sensed", "SensorData", "InitialState", "NavSolution", "RunResult",
         "bench.core.records.run_records.ErrorSeries",
         "bench.experiments.campaigns.outcome.Campaign"),
    ),
    "api-error": ("Errors", ("BenchError", "ConfigError", "EstimatorError", "FlightError")),
}  # fmt: skip
"""Name of a page -> its title and the public names on it; other classes by their full name."""

_LONG = 90  # letters of a signature on one line


def write_pages() -> dict[str, str]:
    """Return the pages of the API by name, in Markdown."""
    import griffe

    package = griffe.load("bench", docstring_parser="numpy", docstring_options={"warnings": False})
    pages = {}
    for page, (title, names) in TOPICS.items():
        lines = [f"# {title}\n", "For frames, signs and units see [conventions](conventions.md).\n"]
        for name in names:
            found = package[name.removeprefix("bench.")]
            found = getattr(found, "final_target", found)  # of an alias
            lines += [f"## {found.name}\n", *_describe(found)]
        pages[page] = "\n".join(lines)
    return pages


def _describe(one: Any) -> Iterator[str]:
    if one.kind.value == "function":
        yield f"```python\n{_format_signature(one)}\n```\n"
    for section in one.docstring.parsed if one.docstring else ():
        kind = section.kind.value
        if kind == "text":
            yield f"{_strip_roles(section.value)}\n"
        elif kind == "examples":
            yield "```pycon\n" + "\n".join(text for _, text in section.value) + "\n```\n"
        elif kind in ("parameters", "raises", "returns", "attributes", "yields"):
            yield f"**{kind.capitalize()}**\n"
            for item in section.value:
                name = getattr(item, "name", "")
                kinds = f" `{str(item.annotation).strip('()')}`" if item.annotation else ""
                words = _strip_roles(" ".join(item.description.split()))
                yield f"- {f'`{name}`' if name else ''}{kinds}: {words}".replace("-  ", "- ")
            yield ""
    if one.kind.value == "class":
        for method in one.functions.values():
            if not method.name.startswith("_") and method.docstring:
                yield f"- `{method.signature()}`: {_strip_roles(method.docstring.value.splitlines()[0])}"
        yield ""


def _format_signature(function: Any) -> str:
    """Return the signature, one parameter a line where it is long."""
    text = str(function.signature())
    if len(text) < _LONG:
        return text
    parts, starred = [], False
    for one in function.parameters:
        kind = one.kind.value if one.kind else ""
        if kind == "keyword-only" and not starred:
            parts.append("*")
            starred = True
        mark = {"variadic positional": "*", "variadic keyword": "**"}.get(kind, "")
        annotation = f": {one.annotation}" if one.annotation else ""
        default = f" = {one.default}" if one.default is not None and not mark else ""
        parts.append(f"{mark}{one.name}{annotation}{default}")
        starred |= mark == "*"
    inner = "".join(f"    {part},\n" for part in parts)
    returns = f" -> {function.returns}" if function.returns else ""
    return f"{function.name}(\n{inner}){returns}"


def _strip_roles(text: str) -> str:
    return re.sub(r":\w+:`~?([^`]+)`", r"`\1`", text)
