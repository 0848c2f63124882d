"""The result of one run: metrics, errors and solutions by estimator, with everything needed to repeat it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from html import escape
from typing import Any

import bench
from bench.data import ErrorSeries, Events, NavSolution, Sensed, SensorData, Trajectory
from bench.fields import Rebuilt


@dataclass(frozen=True, slots=True, repr=False)
class RunResult(Rebuilt):
    """One run of one profile: metrics per estimator, with everything needed to repeat it."""

    profile: Mapping[str, Any]  # the profile as flown, in the units of its file
    seed: int
    run: int
    metrics: Mapping[str, Mapping[str, Any]]  # estimator -> metric -> number, null or list
    errors: Mapping[str, ErrorSeries]
    solutions: Mapping[str, NavSolution]
    provenance: Mapping[str, Any]  # versions, commit, CPU time
    more: Mapping[str, Any] = field(default_factory=dict)  # for a log: "log", "validity", "outages"
    records: Mapping[str, Any] = field(default_factory=dict)  # input of the run: "spec", "truth", "sensed"

    @property
    def name(self) -> str:
        """Name of the profile; empty for a log."""
        return str(self.provenance.get("profile") or "")

    @property
    def truth(self) -> Trajectory | None:
        """The flight; None for a log."""
        return self.records.get("truth")

    @property
    def sensed(self) -> Sensed | None:
        """The reports of the sensors, the errors drawn for them, and the initial state of the estimators."""
        return self.records.get("sensed")

    @property
    def sensors(self) -> SensorData | None:
        """The input of the estimators."""
        return self.sensed.data if self.sensed else None

    @property
    def events(self) -> Events:
        """Events of the flight and of the sensors, in order of time."""
        both = [record.events for record in (self.truth, self.sensed) if record is not None]
        return Events.from_rows([row for events in both for row in events.rows()])

    def plot(self, tab: str, estimator: str | None = None, **look: Any) -> Any:
        """Draw the plots of a tab, such as "position": see `bench.plot_result`."""
        return bench.plot_result(self, tab, estimator, **look)

    def __repr__(self) -> str:
        """Return title, seed, run, and the horizontal position RMSE of each estimator that converged."""
        found = []
        for label, values in self.metrics.items():
            error = values.get("pos_rmse_h_m")
            sound = values.get("converged", True)
            found.append(f"{label} {error:.3g} m" if sound and error is not None else f"{label} -")
        heading = f"{self.profile.get('title', '')!r}, seed {self.seed}, run {self.run}"
        return f"<RunResult {heading}: {', '.join(found)}>"

    def _repr_html_(self) -> str:
        """Return the verdicts, and the metrics without ``_all`` as a table, a column for each estimator."""
        names = {name: None for values in self.metrics.values() for name in values}
        rows = [f"<td></td>{''.join(f'<td>{escape(label)}</td>' for label in self.metrics)}"]
        for name in names:
            values = [one.get(name) for one in self.metrics.values()]
            if not name.endswith("_all") and any(isinstance(v, int | float) for v in values):
                cells = "".join(_make_cell(name, one) for one in self.metrics.values())
                rows.append(f"<td>{escape(name)}</td>{cells}")
        head = escape(f"{self.profile.get('title', '')}: seed {self.seed}, run {self.run}")
        table = f"<table><caption>{head}</caption>{''.join(f'<tr>{row}</tr>' for row in rows)}</table>"
        texts = [
            text
            for values in self.metrics.values()
            for text in (
                values.get("verdict_text", ""),
                *values.get("drift_text", ()),
                *values.get("required_text", ()),
            )
        ]
        return "".join(f"<p>{escape(text)}</p>" for text in texts if text) + table


def _make_cell(name: str, values: Mapping[str, Any]) -> str:
    """Return the cell of a metric, marked and red if it is outside its bounds."""
    text = escape(_format_value(values.get(name)))
    return f'<td style="color:red">{text} !</td>' if name in values.get("outside", ()) else f"<td>{text}</td>"


def _format_value(value: Any) -> str:
    if isinstance(value, float):
        return f"{value:.4g}"
    return "-" if value is None else str(value)
