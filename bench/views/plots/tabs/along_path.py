"""Errors along the path of a flight that an estimate flew: TSE = FTE - NSE."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from bench.core.records.findings.series import BAND, FIX, TRUTH, Plot, Rows, draw_line
from bench.core.records.specs import IN_FLIGHT
from bench.evaluation.errors.total_system import PARTS, resolve_along
from bench.evaluation.metrics.case import select_path
from bench.views.plots.content import Content, Tab

_NAMES = {"tse": "total system error", "fte": "flight technical error", "nse": "navigation system error"}
_COLORS = {"tse": TRUTH, "fte": BAND, "nse": FIX}


def _plots(content: Content) -> Mapping[str, Rows]:
    path, errors = content.path, content.errors.get(IN_FLIGHT)
    if path is None or errors is None:
        return {}
    rows = np.searchsorted(path.t, errors.t - 1e-6)
    found = resolve_along(select_path(path, rows), errors.pos_n)
    plots = []
    for axis, what in (("across", "to the right of the path"), ("up", "above the path")):
        known = np.isfinite(found["tse"][axis])
        if known.any():
            lines = []
            for part in PARTS:
                values = np.where(known, found[part][axis], np.nan)
                lines.append(draw_line(part, errors.t, values, _NAMES[part], _COLORS[part]))
            plots.append([Plot(("path", axis), f"{what} [m]", tuple(lines), content.begin)])
    return {"": plots} if plots else {}


PATH = Tab("Path", 15, _plots)
