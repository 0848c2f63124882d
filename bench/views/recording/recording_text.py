"""Text of a recording: the summary, the log of events, and the times of the legs."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from typing import Any

import rerun as rr

from bench.core.records.findings.series import OUTAGE
from bench.core.records.run_result import RunResult
from bench.core.records.specs import IN_FLIGHT
from bench.core.words.palette import choose_looks
from bench.core.words.wording import format_number, replace_control
from bench.evaluation.consistency.verdict import list_sentences
from bench.evaluation.metrics.outages import DRIFT_MEANING, tabulate_drifts
from bench.evaluation.metrics.run_metrics import find_metric
from bench.views.plots.content import Content
from bench.views.plots.facts import list_facts, list_units
from bench.views.recording.drawing import TIMELINE

_MARKUP = re.compile(r"[\\`*_\[\]<>#!|~]")
"""Characters that mean something in Markdown."""

WARNINGS = ("sanity", "exceedance", "gnss_outage", "fault", "timeline", "rejected", "diverged")
"""Kinds of event that are logged as warnings."""


def send(stream: Any, result: RunResult, content: Content) -> None:
    """Send the summary, the log of events, and which leg and which GNSS there was when."""
    truth, sensed, solutions = content.motion, content.sensed, content.solutions
    page = make_summary(result) + make_drift_page(result.more.get("outages", ()))
    stream.log("/summary", rr.TextDocument(page, media_type=rr.MediaType.MARKDOWN), static=True)
    table = make_verdict_table(result)
    stream.log("/verdicts", rr.TextDocument(table, media_type=rr.MediaType.MARKDOWN), static=True)

    sources = [("", truth.events), ("", sensed.events)]
    sources += [(f"{label}: ", solution.events) for label, solution in solutions.items()]
    rows = []
    for prefix, events in sources:
        for start, end, kind, words, *_ in events.rows():
            what = kind.replace("_", " ")
            said = words if words.lower().startswith(what.lower()) else f"{what} {words}"
            lasting = f" ({end - start:.0f} s)" if end > start else ""
            level = "WARN" if kind in WARNINGS else "INFO"
            rows.append((start, replace_control(f"{prefix}{said}{lasting}"), level))
    rows.sort()
    if rows:
        t, text, levels = zip(*rows, strict=True)
        stream.send_columns(
            "/events",
            [rr.TimeColumn(TIMELINE, duration=t)],
            rr.TextLog.columns(text=text, level=levels),
        )

    first, last = float(truth.t[0]), float(truth.t[-1])
    legs = [(start, text) for start, _, text in truth.events.select("leg")]
    _send_phase(stream, "/phase/leg", legs, last)
    if sensed.data.fixes is not None:
        changes = [(first, "available")]
        for start, end, _ in sensed.events.select("gnss_outage"):
            changes += [(start, "outage"), (end, "available")]
        style = rr.StateConfiguration(values=["available", "outage"], colors=[(70, 110, 70), OUTAGE])
        stream.log("/phase/gnss", style, static=True)
        _send_phase(stream, "/phase/gnss", changes, last)
    struck = sensed.events.select("fault")
    if struck:
        edges = sorted({first, *(edge for start, end, _ in struck for edge in (start, end))})
        changes = [(edge, _name_faults(edge, struck)) for edge in edges if edge < last]
        _send_phase(stream, "/phase/faults", changes, last)


def _escape(text: str) -> str:
    """Return a text as Markdown shows it letter by letter, without control characters."""
    return _MARKUP.sub(r"\\\g<0>", replace_control(str(text)))


def _name_faults(t: float, struck: Sequence[tuple[float, float, str]]) -> str:
    """Return the names of the faults that are active at a time [s]."""
    return ", ".join(text.partition(":")[0] for start, end, text in struck if start <= t < end) or "none"


def _send_phase(stream: Any, entity: str, changes: Sequence[tuple[float, str]], end: float) -> None:
    """Send states with their begin times, up to the end [s]."""
    if changes:
        t, states = zip(*changes, (end, ""), strict=True)
        stream.send_columns(
            entity, [rr.TimeColumn(TIMELINE, duration=t)], rr.StateChange.columns(state=states)
        )


def make_summary(result: RunResult) -> str:
    """Return the markdown summary of a result: the experiment, and the metrics by estimator."""
    metrics, profile = result.metrics, result.profile
    begin = f"{result.evaluation.begin:g} s"
    colors = ", ".join(f"{_escape(label)} {look.name}" for label, look in choose_looks(metrics).items())
    truth = "Fixes are white dots" if result.truth is None else "Truth is green, fixes are white dots"
    grey = ["runway"] if profile.get("runway") else []
    grey += ["desired path"] if "tse_across_max_m" in metrics.get(IN_FLIGHT, {}) else []
    truth += f", {' and '.join(grey)} grey" if grey else ""
    lost = [f"{start:g} to {end:g} s" for start, end, _ in result.events.select("gnss_outage")]
    faults = [f"{start:g} to {end:g} s: {text}" for start, end, text in result.events.select("fault")]
    lines = [
        f"# {_escape(profile['title'])}",
        "",
        *[f"- {_escape(fact)}" for fact in list_facts(result)],
        *[f"- {title} `{replace_control(name).replace('`', '')}`" for title, name, *_ in list_units(profile)],
        *([f"- GNSS outage {', '.join(lost)}"] if lost else []),
        *[f"- fault {_escape(text)}" for text in faults],
        "",
        f"{truth}; {colors}. ±3σ is what a filter reports about itself. Plots are hatched where GNSS is lost "
        f"or a fault is scripted, and scaled to what comes after {begin}.",
    ]
    for label, values in metrics.items():
        for text in (values.get("verdict_text"), *list_sentences(values)):
            lines += ["", _escape(text)] if text else []
        if values.get("same_as"):
            same = f"With these sensors **{_escape(label)}** is the same as **{_escape(values['same_as'])}**."
            lines += ["", same]
        if values.get("unmodeled_errors"):
            missing = _escape(", ".join(values["unmodeled_errors"]))
            lines += ["", f"On board, but not modeled by **{_escape(label)}**: {missing}."]
    lines += [
        "",
        f"**Metrics** from {begin} on",
        "",
        f"| | {' | '.join(map(_escape, metrics))} |",
        f"|---|{'---:|' * len(metrics)}",
    ]
    for name in dict.fromkeys(name for values in metrics.values() for name in values):
        row = [values.get(name) for values in metrics.values()]
        if find_metric(name) is not None and not name.endswith("_all"):
            lines.append(f"| {name} | {' | '.join(format_number(value) for value in row)} |")
    return "\n".join(lines) + "\n"


def make_verdict_table(result: RunResult) -> str:
    """Return the verdicts of all filters as a table in Markdown, with reason, error and claim."""
    lines = ["| | verdict | horizontal error [m] | reported [m] | NEES |", "|---|---|---:|---:|---:|"]
    for label, values in result.metrics.items():
        cells = (format_number(values.get(name)) for name in ("pos_rmse_h_m", "pos_sigma_h_m", "nees_mean"))
        word = "; ".join(filter(None, (values.get("verdict"), values.get("verdict_reason"))))
        lines.append(f"| {_escape(label)} | {_escape(word)} | {' | '.join(cells)} |")
    return "\n".join(lines) + "\n"


def make_drift_page(rows: Sequence[Mapping[str, Any]]) -> str:
    """Return the drift over outages of a log in Markdown; nothing when none was cut."""
    if not rows:
        return ""
    table = tabulate_drifts(rows)
    texts = [table.columns, ("---",) * len(table.columns), *table.rows]
    lines = [f"| {' | '.join(map(str, row))} |" for row in texts]
    return "\n".join(["", "**Horizontal drift without GNSS** [m]", "", *lines, "", DRIFT_MEANING, ""])
