"""The tables of the league, and where they stand in the guide."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import numpy as np

from bench.experiments.card.card_lines import write_figure

PAGE = Path(__file__).parents[2] / "bench" / "guide" / "league.md"
_BEGIN, _END = "<!-- make league writes -->\n", "<!-- to here -->\n"
_COLUMNS = {"attitude": ("tilt", "heading"), "position": ("accuracy", "tilt", "heading")}
_UNITS = {"accuracy": "m", "tilt": "deg", "heading": "deg"}
_HEADS = {"accuracy": "position", "tilt": "tilt", "heading": "heading"}


def write_page(league: dict[str, Any]) -> None:
    """Replace the tables on the page of the guide."""
    text = PAGE.read_text(encoding="utf-8")
    before, _, rest = text.partition(_BEGIN)
    PAGE.write_text(before + _BEGIN + write_tables(league) + _END + rest.partition(_END)[2], encoding="utf-8")


def write_tables(league: dict[str, Any], sort: str = "") -> str:
    """Return the tables of the league in Markdown, in the order of the entries or sorted by a column.

    ``sort`` is a part of the head of a column; a table without it keeps its order.
    """

    def draw(heads: list[str], body: list[list[str]]) -> str:
        at = next((k for k, head in enumerate(heads) if sort and sort in head), None)
        return _draw(heads, body if at is None else sorted(body, key=lambda cells: _first_number(cells[at])))

    parts = []
    for kind, flights in league["flights"].items():
        rows = [row for row in league["rows"] if row["kind"] == kind]
        reference = league["references"][kind]
        title = f"RMS errors of {kind} filters, and their ratio to the errors of `{reference}`:\n"
        parts.append(title)
        for flight in flights:
            heads = [f"{flight}: {_HEADS[topic]}" for topic in _COLUMNS[kind]]
            body = [[_name(row), *_write_ratios(row, flight, _COLUMNS[kind])] for row in rows]
            parts.append(draw(["filter", *heads], body))
        if kind == "position":
            body = [
                [_name(row), *(_write_consistency(row, flight) for flight in flights), _write_drift(row)]
                for row in rows
            ]
            heads = [*(f"{flight}: NEES / ideal" for flight in flights), "outage drift"]
            parts.append("Consistency, and drift in the outage:\n\n" + draw(["filter", *heads], body))
        body = [
            [_name(row), f"{row['package']} {row['version']}", row["told"], _write_end(row)] for row in rows
        ]
        parts.append(draw(["filter", "package", "also gets", "converged"], body))
        body = [_write_facts(row) for row in rows]
        parts.append(draw(["filter", "uses the future", "wrong conventions", "with faults", "CPU"], body))
    minutes = league["cpu_s"] / 60.0
    seed = "the seed of the suite" if league["seed"] is None else f"seed {league['seed']}"
    hashes = ", ".join(f"{kind} {one}" for kind, one in league["suites"].items())
    parts.append(
        f"Measured on {league['stamp']}, {seed}, suites {hashes}, Python {league['versions']['python']}, "
        f"{league['machine']}, {minutes:.1f} CPU minutes.\n"
    )
    return "\n".join(parts)


def _write_facts(row: dict[str, Any]) -> list[str]:
    ahead = row.get("causality", "not audited").partition(";")[0]
    held = _write_interval(row.get("robustness"))
    return [_name(row), ahead, row.get("conventions", "-"), held, _write_interval(row.get("speed"))]


def _first_number(cell: str) -> float:
    found = re.search(r"-?\d[\d.]*(e[+-]?\d+)?", cell)
    return float(found[0]) if found else np.inf


def _name(row: dict[str, Any]) -> str:
    return f"`{row['filter']}`" + (" (smoother)" if row["whole"] else "")


def _draw(heads: list[str], body: list[list[str]]) -> str:
    lines = [heads, ["---"] * len(heads), *body]
    return "".join(f"| {' | '.join(cells)} |\n" for cells in lines)


def _write_interval(found: Any) -> str:
    if not found or found[0] is None:
        return "-"
    value, low, high = (write_figure(one) for one in found)
    return value if low == high else f"{value} ({low} to {high})"


def _write_ratios(row: dict[str, Any], flight: str, topics: tuple[str, ...]) -> list[str]:
    cells = []
    for topic in topics:
        found = row.get("scores", {}).get(flight, {}).get(topic)
        if not found:
            cells.append("-")
            continue
        known = [value for value in found["by_run"] if value is not None]
        rms = write_figure(float(np.sqrt(np.mean(np.square(known)))))
        ratio = _write_interval([found["value"], found["low"], found["high"]])
        cells.append(f"{rms} {_UNITS[topic]}; {ratio}")
    return cells


def _write_consistency(row: dict[str, Any], flight: str) -> str:
    """Return NEES over its expectation by block, with the verdict."""
    found = row.get("scores", {}).get(flight, {}).get("honesty")
    if not found:
        return "not reported"
    blocks = {"position": "pos", "velocity": "vel", "attitude": "phi"}
    ratios = {name: found["parts"].get(f"nees_ratio_{part}") for name, part in blocks.items()}
    told = ", ".join(f"{name} {write_figure(one)}" for name, one in ratios.items() if one is not None)
    return f"{told}: {found['word']}"


def _write_drift(row: dict[str, Any]) -> str:
    found = row.get("scores", {}).get("outage", {}).get("outages")
    return _write_interval([found["value"], found["low"], found["high"]] if found else None)


def _write_end(row: dict[str, Any]) -> str:
    if "converged" not in row:
        return row["failed"]
    total = sum(len(each) for each in row["answers"])
    return f"{row['converged']} of {total}" + (f"; {row['failed'][:120]}" if row["failed"] else "")
