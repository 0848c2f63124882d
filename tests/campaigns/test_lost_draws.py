"""A run that is lost is a row with its reason; what a filter leaves out is not drawn."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import bench
from bench.core.records.data import InitialState, NavSolution, SensorData
from bench.experiments.campaigns.pools import ExecutorPool, SerialExecutor
from bench.experiments.tuning.trials import ProfileTrial
from bench.navigation.built_in import load
from bench.views.report.writing import write_report
from tests.campaigns.test_campaign import PROFILE


class Overflowing:
    """Is lost after 10 s with values that no number holds, in its innovations and velocities."""

    z, S, vel = 1e140, 1e-300, np.inf

    def run(self, sensors: SensorData, initial: InitialState) -> NavSolution:
        found = load("loose-15", {}).run(sensors, initial)
        late = found.innovations.t > 10.0
        z, S = (
            np.where(late, value, column)
            for value, column in ((self.z, found.innovations.z), (self.S, found.innovations.S))
        )
        vel_n = np.where(found.t[:, None] > 10.0, self.vel, found.vel_n)
        return replace(found, vel_n=vel_n, innovations=replace(found.innovations, z=z, S=S))


class Singular(Overflowing):
    """The same with innovations that have no variance."""

    S, vel = 0.0, np.nan


class NotANumber(Overflowing):
    """The same with innovations that are no numbers."""

    z, vel = np.nan, -np.inf


class SilentOfItsInnovations:
    """Is sound, and gives no values of its innovations."""

    def run(self, sensors: SensorData, initial: InitialState) -> NavSolution:
        found = load("loose-15", {}).run(sensors, initial)
        unknown = np.full_like(found.innovations.z, np.nan)
        return replace(found, innovations=replace(found.innovations, z=unknown, S=unknown, nis=unknown))


class PositionsOnly:
    """Gives positions, as a program does that solves fixes: no velocity, no attitude, no accuracy."""

    def run(self, sensors: SensorData, initial: InitialState) -> NavSolution:
        found = load("loose-15", {}).run(sensors, initial)
        rest = ("vel_n", "q_nb", "cov", "gyro_bias_b", "accel_bias_b")
        return replace(found, **{name: np.full_like(getattr(found, name), np.nan) for name in rest})


@pytest.fixture
def here(tmp_path, monkeypatch):
    (tmp_path / "short.toml").write_text(PROFILE)
    monkeypatch.chdir(tmp_path)
    return tmp_path


@pytest.mark.parametrize("which", ["Overflowing", "Singular", "NotANumber"])
def test_a_lost_draw_is_a_row_with_its_reason(here, which):
    """Innovations that are not finite neither end the campaign nor keep it from being continued."""
    uses = [f"tests.campaigns.test_lost_draws:{which}", "loose-15"]
    for runs in (1, 2):
        found = bench.campaign(
            "short.toml", runs, estimators=uses, executor=SerialExecutor(), out="lost", resume=runs == 2
        )
    rows = found.runs.to_pylist()
    assert [row["converged"] for row in rows] == [False, True] * 2
    assert all("velocity is not finite at t = 10.1 s" in row["reason"] for row in rows[::2])
    assert not found.failed
    write_report(here / "lost")
    assert "velocity is not finite" in (here / "lost" / "report.html").read_text()


def test_what_cannot_be_kept_of_a_draw_is_its_reason(here, monkeypatch):
    """A run whose errors cannot be kept fails as one that raises: the others go on."""
    real, calls = bench.experiments.campaigns.worker.nis_by_sensor, list[int]()

    def fail_once(*arguments):
        calls.append(1)
        if len(calls) == 1:
            raise ZeroDivisionError("of the second filter")
        return real(*arguments)

    monkeypatch.setattr(bench.experiments.campaigns.worker, "nis_by_sensor", fail_once)
    found = bench.campaign("short.toml", 2, estimators=["loose-15"], executor=SerialExecutor())
    assert list(found.failed.values()) == ["ZeroDivisionError('of the second filter')"]
    assert [row["converged"] for row in found.runs.to_pylist()] == [False, True]


def test_a_campaign_of_positions_only_has_its_report(here):
    """A metric that no run has is left out of the plots."""
    uses = ["tests.campaigns.test_lost_draws:PositionsOnly"]
    bench.campaign("short.toml", 2, estimators=uses, executor=SerialExecutor(), out="positions")
    write_report(here / "positions")
    text = (here / "positions" / "report.html").read_text()
    assert "runs with at most this horizontal error, rms" in text
    assert "runs with at most this 3D velocity error, rms" not in text


def test_a_filter_without_values_of_its_innovations_is_judged_and_tuned(here):
    """Its cost is that of its errors alone."""
    use = "tests.campaigns.test_lost_draws:SilentOfItsInnovations"
    (outcome,) = bench.campaign("short.toml", 2, estimators=[use], executor=SerialExecutor()).outcomes
    assert outcome.converged.value == 1.0
    costs = [
        ProfileTrial("short.toml", one, 2, ExecutorPool(SerialExecutor(), 1), {}).score({}, "consistency")
        for one in (use, "loose-15")
    ]
    assert np.array_equal(*costs)
