"""The result of one run: metrics, errors and solutions by filter, with everything needed to repeat it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from bench.core.records.data import Events, NavSolution, SensorData, Trajectory
from bench.core.records.fields import Rebuilt
from bench.core.records.run_records import ErrorSeries, Sensed
from bench.core.records.specs import EvaluationWindow
from bench.core.words.notebook import ShownFigure, draw, format_cell, make_frame, write_sentences, write_table


@dataclass(frozen=True, slots=True, repr=False)
class RunResult(Rebuilt):
    """Result of one run: metrics, errors and solutions by filter, and what is needed to repeat it.

    Attributes
    ----------
    profile : mapping
        The profile as flown, in the units of its file.
    seed, run : int
        Seed, and number of the run with this seed.
    metrics : mapping
        Filter -> metric -> number, None or list. The name of a metric ends in its unit.
    errors : mapping of str to ErrorSeries
        Filter -> estimate minus truth.
    solutions : mapping of str to NavSolution
        Filter -> solution.
    provenance : mapping
        Versions, commit, CPU time.
    more : mapping
        For a log: "log", "validity", "outages".
    records : mapping
        Input of the run: "spec", "truth", "sensed"; see also ``truth``, ``sensors`` and ``events``.

    Examples
    --------
    >>> import bench
    >>> result = bench.run("approach", estimators=["loose-15"], causes=False)
    >>> list(result.metrics)
    ['loose-15']
    """

    profile: Mapping[str, Any]
    seed: int
    run: int
    metrics: Mapping[str, Mapping[str, Any]]
    errors: Mapping[str, ErrorSeries]
    solutions: Mapping[str, NavSolution]
    provenance: Mapping[str, Any]
    more: Mapping[str, Any] = field(default_factory=dict)
    records: Mapping[str, Any] = field(default_factory=dict)

    @property
    def name(self) -> str:
        """Name of the profile; empty for a log."""
        return str(self.provenance.get("profile") or "")

    @property
    def evaluation(self) -> EvaluationWindow:
        """Return the evaluation window of the run."""
        return EvaluationWindow.of_document(self.profile)

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

    def plot(self, tab: str | None = None, estimator: str | None = None, **look: Any) -> Any:
        """Draw the plots of a tab, such as "position"; `look` as for `plot_result`."""
        return draw(self, tab, estimator, **look)

    def __repr__(self) -> str:
        """Return title, seed, run, and the horizontal position RMSE of each filter that converged."""
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
        shown = [
            name
            for name in names
            if not name.endswith("_all")
            and any(isinstance(one.get(name), int | float) for one in self.metrics.values())
        ]
        columns = {label: [_mark(name, one) for name in shown] for label, one in self.metrics.items()}
        head = f"{self.profile.get('title', '')}: seed {self.seed}, run {self.run}"
        texts = [
            text
            for values in self.metrics.values()
            for text in (
                values.get("verdict_text", ""),
                *values.get("drift_text", ()),
                *values.get("required_text", ()),
            )
        ]
        return write_sentences(texts) + write_table(head, {"": shown, **columns})

    def frame(self) -> Any:
        """Return the metrics as a pandas.DataFrame, a column for each estimator."""
        return make_frame({label: dict(values) for label, values in self.metrics.items()})


def _mark(name: str, values: Mapping[str, Any]) -> Any:
    """Return the value of a metric, red if it is outside its bounds."""
    value = values.get(name)
    return ShownFigure(format_cell(value), outside=True) if name in values.get("outside", ()) else value
