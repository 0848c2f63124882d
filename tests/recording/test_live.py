"""A flight that is shown while it is flown: in the viewer stands where it is, and no bit of it changes."""

from __future__ import annotations

import numpy as np
import pytest
import rerun as rr
from numpy.testing import assert_allclose, assert_array_equal

from bench import closed_loop, config, earth, pipeline
from bench.cli import main
from bench.errors import ViewerError
from bench.recording import column, live
from bench.workbench import viewer
from tests.test_closed_loop import PROFILE

SCALARS = "Scalars:scalars"


@pytest.fixture
def shown(tmp_path):
    """What shows a flight, in a file instead of a viewer."""
    path = tmp_path / "live.rrd"
    stream = rr.RecordingStream("live")
    stream.save(path)
    return live.LiveFlight(stream), stream, path


def test_truth_and_estimate_are_shown_as_they_fly_and_no_bit_changes(tmp_path, shown):
    (tmp_path / "closed.toml").write_text(PROFILE)
    profile = config.load_profile(tmp_path / "closed.toml")
    flight, stream, path = shown
    seen = []

    def show(piece, estimate):
        seen.append((piece.t[-1], estimate))
        flight(piece, estimate)

    flown = closed_loop.fly(profile, show=show)
    stream.disconnect()
    other = closed_loop.fly(profile)
    assert_array_equal(flown.truth.lla, other.truth.lla)
    assert_array_equal(flown.answers.cov, other.answers.cov)
    assert len(seen) == np.ceil(flown.truth.t[-1] / 0.2)  # piece by piece, not at the end
    truth = flown.truth
    t, alt = column(path, "/altitude/truth", SCALARS)
    assert_allclose(t, np.arange(len(t)), atol=1e-6)
    assert len(t) == int(truth.t[-1]) + 1
    assert_allclose(alt[:, 0], truth.lla[np.searchsorted(truth.t, t - 1e-6), 2])
    t, off = column(path, "/error/horizontal", SCALARS)
    rows = np.searchsorted(flown.answers.t, t - 1e-6)
    true = truth.lla[np.searchsorted(truth.t, t - 1e-6)]
    error = earth.difference_n(flown.answers.lla[rows], true)
    assert_allclose(off[:, 0], np.hypot(error[:, 0], error[:, 1]), atol=1e-9)


def test_a_flight_by_the_truth_is_shown_whether_it_is_flown_or_comes_from_the_cache(tmp_path, shown):
    text = PROFILE.replace('[guidance]\nnavigation = "loose-15"\n', "")
    (tmp_path / "open.toml").write_text(text)
    profile = config.load_profile(tmp_path / "open.toml")
    flight, stream, path = shown
    seen = []

    def show(piece, estimate):
        seen.append(piece)
        flight(piece, estimate)

    for _ in range(2):
        seen.clear()
        result = pipeline.run(profile, show=show)
        assert seen[-1].t[-1] == result.truth.t[-1]
    stream.disconnect()
    assert len(column(path, "/altitude/truth", SCALARS)[0]) == int(result.truth.t[-1]) + 1


class Heard:
    """Takes what would go to a viewer."""

    def __init__(self):
        self.lines = {}

    def send_blueprint(self, blueprint): ...

    def set_time(self, timeline, duration): ...

    def log(self, place, what, static=False):
        if isinstance(what, rr.LineStrips3D):
            self.lines[place] = len(what.strips.as_arrow_array().to_pylist()[0])


def test_a_line_of_a_long_flight_goes_on_in_the_next_one():
    """What is sent again each second does not grow with the flight."""
    heard = Heard()
    flight = live.LiveFlight(heard)
    flight._origin = origin = np.array([0.8, 0.2, 1000.0])
    for k in range(130):
        flight._show("truth", float(k), origin + np.array([0.0, 0.0, k]), (0, 0, 0))
    assert heard.lines == {f"/world/truth/path/{k}": points for k, points in enumerate((60, 61, 11))}


def test_without_a_viewer_a_line_says_so_and_the_run_goes_on(tmp_path, monkeypatch, capsys):
    (tmp_path / "closed.toml").write_text(PROFILE)

    def refuse(name):
        raise ViewerError("no display for a window")

    monkeypatch.setattr(viewer, "open_live", refuse)
    out = tmp_path / "out"
    given = ["--live", "--no-report", "--no-rrd"]
    assert main(["run", str(tmp_path / "closed.toml"), "-o", str(out), *given]) in (0, 1)
    assert "Nothing is shown live: no display for a window." in capsys.readouterr().out
    assert (out / "result.json").is_file()


def test_a_viewer_that_does_not_start_is_ended_and_told(monkeypatch):
    monkeypatch.setenv("DISPLAY", ":0")
    monkeypatch.setattr(viewer, "_find_viewer", lambda: "false")
    with pytest.raises(ViewerError, match="the viewer did not start"):
        viewer.open_live("figure-eight")
