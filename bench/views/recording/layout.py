"""Layout of a recording: the tabs of the rerun viewer and their views."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np
import rerun as rr
import rerun.blueprint as rrb

from bench.core.records.findings.series import Plot, Rows
from bench.views.plots.content import Tab
from bench.views.plots.tabs import TABS
from bench.views.plots.tabs.comparison import COMPARISON
from bench.views.plots.tabs.flight_data import FLIGHT
from bench.views.plots.tabs.navigation_errors import ATTITUDE, POSITION
from bench.views.plots.tabs.satellites import SATELLITES
from bench.views.recording import sky_view
from bench.views.recording.drawing import TIMELINE, entity
from bench.views.recording.space import Scene

Plots = Mapping[str, Mapping[str, Rows]]
"""Name of the tab -> label of the filter -> its rows of plots."""

SIDE_BY_SIDE = 3
"""Up to this many filters are shown side by side; with more, each has a tab."""

_LEGEND_WIDTH, _LEGEND_HEIGHT = 0.25, 0.5
"""Of a plot."""

SHARED_TIME_AXIS = "view/5c0dca6a-e63f-9cf7-f657-2602590474cc/TimeAxis"
"""Where the viewer keeps the range of the time axes that are linked: a view that is never shown."""


def make_blueprint(scene: Scene, plots: Plots, main: str) -> Any:
    """Make the blueprint of a recording.

    Parameters
    ----------
    scene : Scene
        The flight in space and time.
    plots : mapping of mappings
        Every plot, by tab and estimator.
    main : str
        Label of the filter the overview shows.

    Returns
    -------
    blueprint : rerun.blueprint.Blueprint
        It opens paused, with every time axis on the whole flight.
    """
    views = [_make_overview(scene, plots, main)]
    for tab in TABS:
        columns = {label: rows for label, rows in plots[tab.name].items() if any(rows)}
        if columns:
            views.append(_make_tab(scene, tab, columns))
    return LinkedBlueprint(
        scene.end,
        rrb.Tabs(*views, active_tab=0),
        rrb.TimePanel(timeline=TIMELINE, play_state="paused", playback_speed=10.0, state="collapsed"),
        rrb.BlueprintPanel(state="collapsed"),
        rrb.SelectionPanel(state="collapsed"),
        auto_layout=False,
        auto_views=False,
    )


class LinkedBlueprint(rrb.Blueprint):
    """A blueprint with linked time axes that begin on the whole flight, not on the minute of the viewer."""

    def __init__(self, end: float, *parts: Any, **options: Any) -> None:
        super().__init__(*parts, **options)
        self.end = end  # of the flight [s]

    def _log_to_stream(self, stream: Any) -> None:
        super()._log_to_stream(stream)
        edge = rrb.TimeRangeBoundary.absolute
        whole = rr.TimeRange(start=edge(seconds=0.0), end=edge(seconds=1.03 * self.end))
        stream.log(SHARED_TIME_AXIS, rrb.TimeAxis(view_range=whole))


def _make_overview(scene: Scene, plots: Plots, main: str) -> Any:
    position, attitude = (plots[tab.name].get(main, ()) for tab in (POSITION, ATTITUDE))
    others = plots[COMPARISON.name].get("", ())[:1]
    key_plots = [row[0] for row in (*others, *position, *attitude[2:])] or [plots[FLIGHT.name][""][0][0]]

    where = rrb.Vertical(_make_space_view(scene), _make_map(scene), row_shares=[3, 2])
    errors = rrb.Vertical(
        *[make_plot(scene.end, plot, legend=k == 0) for k, plot in enumerate(key_plots)],
        _make_phases(),
        row_shares=[5.0, *[3.0] * (len(key_plots) - 1), 4.0],  # the first has room for its legend
    )
    words = rrb.Vertical(
        rrb.TextDocumentView(origin="/summary", name="Summary"),
        rrb.TextLogView(
            origin="/events",
            name="Events",
            columns=rrb.TextLogColumns(timeline_columns=[TIMELINE], text_log_columns=["loglevel", "body"]),
        ),
        row_shares=[3, 2],
    )
    return rrb.Horizontal(where, errors, words, column_shares=[5, 5, 3], name="Overview")


def _make_tab(scene: Scene, tab: Tab, columns: Mapping[str, Rows]) -> Any:
    narrow = all(len(row) == 1 for rows in columns.values() for row in rows)
    beside = narrow and len(columns) <= SIDE_BY_SIDE
    grids = [
        rrb.Vertical(
            *_make_rows(scene, rows, label="" if beside else label),
            *([_make_phases()] if narrow else []),
            row_shares=[4.0] * len(rows) + ([2.0] if narrow else []),
            name=label or None,
        )
        for label, rows in columns.items()
    ]
    if tab is SATELLITES:
        return rrb.Horizontal(
            sky_view.make_view(), *grids, column_shares=[1.0] * (1 + len(grids)), name=tab.name
        )
    if tab is COMPARISON:
        verdicts = rrb.TextDocumentView(origin="/verdicts", name="Verdicts")
        return rrb.Horizontal(*grids, verdicts, column_shares=[3, 1], name=tab.name)
    if len(grids) == 1:
        grids[0].name = tab.name
        return grids[0]
    if beside:
        return rrb.Horizontal(*grids, name=tab.name)
    return rrb.Tabs(*grids, name=tab.name, active_tab=0)


def _make_rows(scene: Scene, rows: Rows, *, label: str) -> Iterator[Any]:
    """Yield the views of each row; titles leave out the label, which is on the tab.

    A plot has a legend if it names anything that no plot before it does; the title is enough for one name.
    """
    told: set[str] = set()
    for row in rows:
        views = []
        for plot in row:
            title = plot.title.removeprefix(f"{label}: ")
            new = {name for one in plot.series for name in one.names} - told
            legend = len(new) > 1 or any(name.lower() not in title.lower() for name in new)
            views.append(make_plot(scene.end, plot, legend=legend, name=title))
            told |= new
        yield views[0] if len(views) == 1 else rrb.Horizontal(*views)


def _find_free_corner(plot: Plot, end: float) -> Any:
    """Return the corner of a plot in which a legend covers least."""
    low, high = plot.limits()
    covered = {}
    for corner in (
        rrb.Corner2D.LeftTop,
        rrb.Corner2D.RightTop,
        rrb.Corner2D.LeftBottom,
        rrb.Corner2D.RightBottom,
    ):
        left, top = corner.name.startswith("Left"), corner.name.endswith("Top")
        count = 0.0
        for one in plot.series:
            inside = one.t < _LEGEND_WIDTH * end if left else one.t > (1.0 - _LEGEND_WIDTH) * end
            up = (one.values[inside] - low) / (high - low)
            count += (
                float(((up > 1.0 - _LEGEND_HEIGHT) if top else (up < _LEGEND_HEIGHT)).mean())
                if up.size
                else 0.0
            )
        covered[corner] = count
    return min(covered, key=lambda corner: covered[corner])


def make_plot(end: float, plot: Plot, *, legend: bool, name: str = "") -> Any:
    """Return the view of a plot of a recording that ends at ``end`` [s]."""
    return rrb.TimeSeriesView(
        origin=entity(*plot.path),
        contents="$origin/**",
        name=name or plot.title,
        axis_x=rrb.TimeAxis(link="LinkToGlobal"),
        axis_y=rrb.ScalarAxis(range=plot.limits()),
        plot_legend=rrb.PlotLegend(_find_free_corner(plot, end), visible=legend),
    )


def _make_phases() -> Any:
    return rrb.StateTimelineView(
        origin="/phase", name="Legs, GNSS, faults", time_view=rrb.TimeAxis(link="LinkToGlobal")
    )


def _show_past(scene: Scene, root: str) -> dict[Any, Any]:
    """Show the fixes of a view in space up to the cursor, and hide what is switched off."""
    past = rrb.VisibleTimeRange(
        TIMELINE,
        start=rrb.TimeRangeBoundary.infinite(),
        end=rrb.TimeRangeBoundary.cursor_relative(seconds=0.0),
    )
    shown: dict[Any, Any] = {path: rrb.VisibleTimeRanges(past) for path in scene.fixes}
    shown |= {path: rrb.EntityBehavior(visible=False) for path in scene.hidden}
    return {path: behavior for path, behavior in shown.items() if path.startswith(root)}


def _make_space_view(scene: Scene) -> Any:
    middle = 0.5 * (scene.low + scene.high)
    eye = middle + scene.size * np.array([-0.8, -0.25, -0.6])
    return rrb.Spatial3DView(
        origin="/world",
        name=f"Flight path (grid {scene.grid:g} m, aircraft enlarged)",
        eye_controls=rrb.EyeControls3D(position=eye, look_target=middle, eye_up=(0.0, 0.0, -1.0)),
        line_grid=rrb.LineGrid3D(visible=True, spacing=scene.grid),
        overrides=_show_past(scene, "/world"),
    )


def _make_map(scene: Scene) -> Any:
    # at zoom z a tile of 256 points covers (length of the parallel) / 2^z; a view has about 500 points
    meters = 1.4 * scene.size / 500.0
    zoom = np.log2(40_075_017.0 * np.cos(scene.lat) / 256.0 / meters)
    return rrb.MapView(
        origin="/map",
        name="Map (its background needs the network)",
        zoom=float(np.clip(zoom, 1.0, 18.0)),
        overrides=_show_past(scene, "/map"),
    )
