"""A flight in the viewer while it is flown: the truth and, where one flies it, the estimate.

What is shown is not kept: the recording of the run is made of its result, as always.
"""

from __future__ import annotations

import re
from collections.abc import Callable
from typing import Any

import numpy as np
import rerun as rr
import rerun.blueprint as rrb

from bench.core.mathematics import earth
from bench.core.mathematics.arrays import FloatArray
from bench.core.records.data import NavSolution, Trajectory
from bench.core.records.findings.series import ESTIMATORS, TRUTH
from bench.core.records.run_records import ShowFlight
from bench.core.records.specs import IN_FLIGHT
from bench.core.words.palette import Color
from bench.views.recording.drawing import TIMELINE

_STEP = 1.0  # between two points of a path, and two values of a plot [s]
_MOST = 60  # points of a line, which is sent again with each: then the next one begins


class LiveFlight:
    """Sends a flight to a viewer as it goes on; call it with each piece of the truth.

    Parameters
    ----------
    stream : rerun.RecordingStream
        That of the viewer.
    """

    def __init__(self, stream: Any) -> None:
        self._stream = stream
        self._origin: FloatArray | None = None
        self._lines: dict[str, list[FloatArray]] = {}
        self._next = 0.0  # time to show [s]
        plots = [rrb.TimeSeriesView(origin=f"/{name}", name=f"{name} [m]") for name in ("altitude", "error")]
        stream.send_blueprint(
            rrb.Blueprint(
                rrb.Horizontal(rrb.Spatial3DView(origin="/world", name="Flight"), rrb.Vertical(*plots)),
                rrb.TimePanel(state="collapsed"),
                collapse_panels=True,
            )
        )

    def __call__(self, piece: Trajectory, estimate: NavSolution | None) -> None:
        """Show a piece of the truth, and the estimate at its end if there is one."""
        if self._origin is None:
            self._origin = np.array(piece.lla[0])
            self._stream.log("/world", rr.ViewCoordinates.FRD, static=True)
        rows = []
        while self._next <= piece.t[-1] + 1e-6:
            rows.append(int(np.searchsorted(piece.t, self._next - 1e-6)))
            self._next += _STEP
        for row in rows:
            self._show("truth", float(piece.t[row]), piece.lla[row], TRUTH)
        known = estimate is not None and len(estimate) > 0 and bool(np.isfinite(estimate.lla[-1]).all())
        if rows and estimate is not None and known:
            t, lla = float(piece.t[-1]), estimate.lla[-1]
            self._show(IN_FLIGHT, t, lla, ESTIMATORS[0])
            off = earth.difference_n(lla, piece.lla[-1])
            for name, value in (("horizontal", float(np.hypot(*off[:2]))), ("down", float(off[2]))):
                self._stream.log(f"/error/{name}", rr.Scalars(value))

    def _show(self, name: str, t: float, lla: FloatArray, color: Color) -> None:
        """Show where somebody is at a time [s]."""
        assert self._origin is not None
        stream, line = self._stream, self._lines.setdefault(name, [])
        stream.set_time(TIMELINE, duration=t)
        line.append(earth.local_ned(lla, self._origin))
        number = (len(line) - 1) // _MOST
        points, place = np.array(line[max(number * _MOST - 1, 0) :]), f"/world/{name}"
        stream.log(f"{place}/path/{number}", rr.LineStrips3D([points], colors=[color], radii=[-1.0]))
        stream.log(f"{place}/position", rr.Points3D([line[-1]], colors=[color], radii=[-6.0]))
        stream.log(f"/altitude/{name}", rr.Scalars(float(lla[2])))


def make_show(name: str, send: Callable[[bytes], object]) -> ShowFlight:
    """Return what shows the flight of a profile; ``send`` takes what a viewer reads at its standard input."""
    stream = rr.RecordingStream("bench-live-" + re.sub(r"[^A-Za-z0-9._-]", "-", name))
    encoded = rr.binary_stream(stream)
    flight = LiveFlight(stream)

    def show(piece: Trajectory, estimate: NavSolution | None) -> None:
        flight(piece, estimate)
        if data := encoded.read():
            send(data)

    return show
