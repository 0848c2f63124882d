"""Layout of a recording: the tabs of the rerun viewer and their views."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import rerun as rr
import rerun.blueprint as rrb

from bench.plots.content import Tab
from bench.plots.series import Plot, Rows
from bench.plots.tabs import TABS
from bench.plots.tabs.comparison import COMPARISON
from bench.plots.tabs.flight_data import FLIGHT
from bench.plots.tabs.navigation_errors import ATTITUDE, POSITION
from bench.plots.tabs.satellites import SATELLITES
from bench.recording import sky_view
from bench.recording.drawing import TIMELINE, entity
from bench.recording.space import Scene

Plots = Mapping[str, Mapping[str, Rows]]
"""Name of the tab -> label of the estimator -> its rows of plots."""

SIDE_BY_SIDE = 3
"""Up to this many estimators are shown side by side; with more, each has a tab."""


def make_blueprint(scene: Scene, plots: Plots, main: str) -> Any:
    """Make the blueprint of a recording.

    Parameters
    ----------
    scene : Scene
        The flight in space and time.
    plots : mapping of mappings
        Every plot, by tab and estimator.
    main : str
        Label of the estimator the overview shows.

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
    return rrb.Blueprint(
        rrb.Tabs(*views, active_tab=0),
        rrb.TimePanel(timeline=TIMELINE, play_state="paused", playback_speed=10.0, state="collapsed"),
        rrb.BlueprintPanel(state="collapsed"),
        rrb.SelectionPanel(state="collapsed"),
        auto_layout=False,
        auto_views=False,
    )


def _make_overview(scene: Scene, plots: Plots, main: str) -> Any:
    position, attitude = (plots[tab.name].get(main, ()) for tab in (POSITION, ATTITUDE))
    others = plots[COMPARISON.name].get("", ())[:1]
    key_plots = [row[0] for row in (*others, *position, *attitude[2:])] or [plots[FLIGHT.name][""][0][0]]

    where = rrb.Vertical(_make_space_view(scene), _make_map(scene), row_shares=[3, 2])
    errors = rrb.Vertical(
        *[_make_plot(scene, plot, legend=k == 0) for k, plot in enumerate(key_plots)], _make_phases(scene)
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
            *[
                _make_row(scene, row, legend=k == 0, label="" if beside else label)
                for k, row in enumerate(rows)
            ],
            *([_make_phases(scene)] if narrow else []),
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


def _make_row(scene: Scene, row: Sequence[Plot], *, legend: bool, label: str) -> Any:
    """Return the views of a row; titles leave out the label that stands on the tab."""
    views = [
        _make_plot(scene, plot, legend=legend and k == 0, name=plot.title.removeprefix(f"{label}: "))
        for k, plot in enumerate(row)
    ]
    return views[0] if len(views) == 1 else rrb.Horizontal(*views)


def _make_time_axis(scene: Scene) -> Any:
    """Return a time axis of the whole flight; axes linked by the viewer would open on a minute of it."""
    edge = rrb.TimeRangeBoundary.absolute
    return rrb.TimeAxis(view_range=rr.TimeRange(start=edge(seconds=0.0), end=edge(seconds=1.01 * scene.end)))


def _make_plot(scene: Scene, plot: Plot, *, legend: bool, name: str = "") -> Any:
    return rrb.TimeSeriesView(
        origin=entity(*plot.path),
        contents="$origin/**",
        name=name or plot.title,
        axis_x=_make_time_axis(scene),
        axis_y=rrb.ScalarAxis(range=plot.limits()),
        plot_legend=rrb.PlotLegend(rrb.Corner2D.LeftTop, visible=legend),
    )


def _make_phases(scene: Scene) -> Any:
    return rrb.StateTimelineView(origin="/phase", name="Legs, GNSS, faults", time_view=_make_time_axis(scene))


def _show_past(scene: Scene, root: str) -> dict[Any, Any]:
    """Show the fixes of a view in space up to the cursor, and hide what is switched off."""
    past = rrb.VisibleTimeRange(
        TIMELINE,
        start=rrb.TimeRangeBoundary.infinite(),
        end=rrb.TimeRangeBoundary.cursor_relative(seconds=0.0),
    )
    shown: dict[Any, Any] = {path: rrb.VisibleTimeRanges(past) for path in scene.fixes}
    shown |= {path: rrb.EntityBehavior(visible=False) for path in scene.hidden}
    return {path: behaviour for path, behaviour in shown.items() if path.startswith(root)}


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
    metres = 1.4 * scene.size / 500.0
    zoom = np.log2(40_075_017.0 * np.cos(scene.lat) / 256.0 / metres)
    return rrb.MapView(
        origin="/map",
        name="Map (its background needs the network)",
        zoom=float(np.clip(zoom, 1.0, 18.0)),
        overrides=_show_past(scene, "/map"),
    )
