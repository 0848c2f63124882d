"""What a recording says in words: the summary, the log of events, and which leg was flown when."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import rerun as rr

from bench.config.log import LogSpec
from bench.data import NavSolution, Sensed
from bench.evaluation.key_figures import format_number
from bench.evaluation.metrics import find_metric
from bench.evaluation.outages import DRIFT_COLUMNS, DRIFT_MEANING, format_drift_row
from bench.instruments import INSTRUMENTS
from bench.plots.content import Motion
from bench.plots.series import ESTIMATOR_NAMES, OUTAGE
from bench.recording.drawing import TIMELINE
from bench.specs import AssumedSpecs, Flight, FlightSpec, Profile, SensorsSpec

WARNINGS = ("sanity", "gnss_outage", "fault", "timeline", "rejected", "diverged")
"""Kinds of event that are logged as warnings."""


def send(
    stream: Any,
    profile: Profile | LogSpec,
    truth: Motion,
    sensed: Sensed,
    solutions: Mapping[str, NavSolution],
    metrics: Mapping[str, Mapping[str, Any]],
    outages: Sequence[Mapping[str, Any]],
) -> None:
    """Send the summary, the log of events, and which leg and which GNSS there was when."""
    page = make_summary(profile, truth, metrics) + make_drift_page(outages)
    stream.log("/summary", rr.TextDocument(page, media_type=rr.MediaType.MARKDOWN), static=True)

    sources = [("", truth.events), ("", sensed.events)]
    sources += [(f"{label}: ", solution.events) for label, solution in solutions.items()]
    rows = []
    for prefix, events in sources:
        for start, end, kind, words, *_ in events.rows():
            what = kind.replace("_", " ")
            said = words if words.lower().startswith(what.lower()) else f"{what} {words}"
            lasting = f" ({end - start:.0f} s)" if end > start else ""
            level = "WARN" if kind in WARNINGS else "INFO"
            rows.append((start, f"{prefix}{said}{lasting}", level))
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


def _name_faults(t: float, struck: Sequence[tuple[float, float, str]]) -> str:
    """Return the names of the faults that are active at an instant [s]."""
    return ", ".join(text.partition(":")[0] for start, end, text in struck if start <= t < end) or "none"


def _send_phase(stream: Any, entity: str, changes: Sequence[tuple[float, str]], end: float) -> None:
    """Send what holds from which instant on, until the end [s]."""
    if changes:
        t, states = zip(*changes, (end, ""), strict=True)
        stream.send_columns(
            entity, [rr.TimeColumn(TIMELINE, duration=t)], rr.StateChange.columns(state=states)
        )


def make_summary(profile: Profile | LogSpec, truth: Motion, metrics: Mapping[str, Mapping[str, Any]]) -> str:
    """Return the markdown summary of a run: the experiment, and the metrics by estimator."""
    colours = ", ".join(
        f"{label} {ESTIMATOR_NAMES[k % len(ESTIMATOR_NAMES)]}" for k, label in enumerate(metrics)
    )
    lines_above = (
        _describe_log(profile, colours)
        if isinstance(profile, LogSpec)
        else _describe_run(profile, truth, colours)
    )
    lines = [f"# {profile.title}", "", *lines_above]
    for label, values in metrics.items():
        for text in (values.get("verdict_text"), *values.get("drift_text", ())):
            lines += ["", text] if text else []
        if values.get("same_as"):
            lines += ["", f"With these sensors **{label}** is the same as **{values['same_as']}**."]
        if values.get("unmodelled"):
            lines += ["", f"On board, but not modelled by **{label}**: {', '.join(values['unmodelled'])}."]
    lines += [
        "",
        f"**Metrics** from {profile.evaluation_from:g} s on",
        "",
        f"| | {' | '.join(metrics)} |",
        f"|---|{'---:|' * len(metrics)}",
    ]
    for name in dict.fromkeys(name for values in metrics.values() for name in values):
        row = [values.get(name) for values in metrics.values()]
        if find_metric(name) is not None and not name.endswith("_all"):
            lines.append(f"| {name} | {' | '.join(format_number(value) for value in row)} |")
    return "\n".join(lines) + "\n"


def _describe_run(profile: Profile, truth: Motion, colours: str) -> list[str]:
    """Describe a flight in lines above its metrics."""
    sensors = profile.sensors
    lost = ", ".join(f"{start:g} to {end:g} s" for start, end in sensors.gnss_outages)
    return [
        f"- profile `{profile.name}`, seed {profile.seed}",
        f"- {_describe_flight(profile.flight, truth)}",
        *[f"- {what} `{unit.name}`" for what, unit in _list_sensors(sensors)],
        *([f"- GNSS outage {lost}"] if lost else []),
        *[
            f"- fault {k}, {fault.start:g} to {fault.end:g} s: {fault.text}"
            for k, fault in enumerate(sensors.faults, 1)
        ],
        "",
        f"Truth is green, GNSS yellow; {colours}. ±3σ is what a filter claims about itself. Plots are "
        f"hatched where GNSS is lost or a fault is scripted, and scaled to what comes after "
        f"{profile.evaluation_from:g} s.",
    ]


def _describe_log(log: LogSpec, colours: str) -> list[str]:
    """Describe a log in lines above its metrics."""
    kept = f"one fix in {log.withhold}" if log.withhold else "no fix"
    return [
        f"- recording `{log.name}`",
        *[f"- {what} assumed to be a `{unit.name}`" for what, unit in _list_sensors(log.assumed)],
        "",
        f"GNSS is yellow; {colours}. There is no truth: {kept} was kept from the filters, and errors are "
        "estimate minus these fixes, at the antenna. ±3σ is what a filter claims about itself. Plots are "
        f"scaled to what comes after {log.evaluation_from:g} s.",
    ]


def _list_sensors(specs: SensorsSpec | AssumedSpecs) -> list[tuple[str, Any]]:
    """Return title and spec of each sensor present."""
    titles = {"imu": "IMU", "gnss": "GNSS", **{name: row.title for name, row in INSTRUMENTS.items()}}
    units = [(title, getattr(specs, name)) for name, title in titles.items()]
    return [(title, unit) for title, unit in units if unit is not None]


def _describe_flight(flight: Flight, truth: Motion) -> str:
    length = f"{truth.t[-1] - truth.t[0]:.0f} s"
    if not isinstance(flight, FlightSpec):
        beyond = len(truth.events.select("sanity"))
        remarks = f", {beyond} remarks of sanity among the events" if beyond else ""
        return f"{flight.label}, {length}{remarks}"
    return (
        f"aircraft `{flight.aircraft.name}`, {length}, wind "
        f"{flight.wind_speed:g} m/s from {np.rad2deg(flight.wind_from):.0f} deg, "
        f"turbulence severity {flight.severity}"
    )


def make_drift_page(table: Sequence[Mapping[str, Any]]) -> str:
    """Return the drift over outages of a log in Markdown; nothing when none was cut."""
    if not table:
        return ""
    rows = [DRIFT_COLUMNS, ("---",) * len(DRIFT_COLUMNS), *map(format_drift_row, table)]
    lines = [f"| {' | '.join(row)} |" for row in rows]
    return "\n".join(["", "**Horizontal drift without GNSS** [m]", "", *lines, "", DRIFT_MEANING, ""])
