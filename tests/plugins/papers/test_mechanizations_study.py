"""The study of the mechanizations on a short flight: its tables, and the law of accelerometers alone."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.testing import assert_allclose

import bench
from bench.core.mathematics import earth, rotation
from bench.core.mathematics.units import STANDARD_GRAVITY
from bench.plugins.papers import mechanization_costs
from bench.plugins.papers.mechanization_costs import (
    acceleration_error,
    coning_drift,
    gravity_error,
    radii_error,
    simulate_accelerometers,
)
from bench.plugins.papers.mechanizations.accelerometers import drift_by_angular_acceleration


@pytest.fixture(scope="module")
def found():
    return bench.study("mechanizations", duration_s=12, coning_rates_hz=(100,), bases_m=(0.5, 1.0))


def test_every_algorithm_has_a_row(found):
    attitudes = found.tables["attitudes"].columns
    assert attitudes["samples"] == [1, 1, 1, 1, 1, 2, 3, 4]
    assert_allclose(attitudes["coning_100_hz_deg_h"][:4], 9.60, rtol=0.01)
    assert attitudes["coning_100_hz_deg_h"][5] == pytest.approx(2.72, rel=0.01)
    assert max(attitudes["level_turns_arcsec"]) < 0.2
    assert min(attitudes["step_us"]) > 0
    frames = found.tables["frames"].columns
    assert len(frames["frame"]) == 1 + 5 * 2 * 3
    lead = np.array(frames["lead"])
    slow = np.array([rates == "100/50/10" for rates in frames["rates_hz"]])
    position = np.array(frames["position_m"])
    assert position[lead & slow].sum() < 0.2 * position[~lead & slow].sum()


@pytest.mark.parametrize(("rate", "half", "cone"), [(100, 0.1, 20.0), (400, 0.2, 20.0), (200, 0.1, 45.0)])
def test_9_one_increment_in_a_step_drifts_as_the_closed_form(rate, half, cone):
    """Half the square of the half angle times the frequency, less what the sums see of it: 1 - sin x / x."""
    w = 2.0 * np.pi * cone
    expected = 0.5 * np.deg2rad(half) ** 2 * w * (1.0 - np.sinc(w / rate / np.pi))
    found = np.deg2rad(coning_drift(rate, 1, "two-quaternions", half, cone)) / 3600.0
    assert found == pytest.approx(expected, rel=0.01)


def test_the_words_and_pictures_are_those_of_the_tables(found):
    attitudes, frames, alone = (
        found.tables[name].columns for name in ("attitudes", "frames", "accelerometers")
    )
    ends = attitudes["attitude_arcsec"]
    assert f"off by {min(ends):.2g} arcsec" in found.verdicts[0]
    assert f"and by {max(ends):.2g} with" in found.verdicts[0]
    plots = {
        plot.path[1]: {one.key: np.ravel(one.values) for one in plot.series}
        for plot in found.findings.figures
    }
    for name, samples, off in zip(
        attitudes["attitude"], attitudes["samples"], attitudes["position_m"], strict=True
    ):
        if samples == 1:
            assert plots["growth"][name][-1] == pytest.approx(off)
    cones = dict(
        zip(
            zip(attitudes["attitude"], attitudes["samples"], strict=True),
            attitudes["coning_100_hz_deg_h"],
            strict=True,
        )
    )
    assert plots["coning"]["sum"] == pytest.approx(cones["two-quaternions", 1])
    assert plots["coning"]["vector, 3"] == pytest.approx(cones["rotation-vector", 3])
    rows = list(zip(*(frames[name] for name in ("frame", "lead", "rates_hz", "position_m")), strict=True))
    for name in ("nhe", "ecef", "inertial"):
        for lead in (True, False):
            offs = [off for one, ahead, _, off in rows if (one, ahead) == (name, lead)]
            assert plots["rates"][f"{name}{'' if lead else ', lagging'}"] == pytest.approx(offs[::-1])
    assert [one for name, lead, one, _ in rows if (name, lead) == ("nhe", True)] == [
        "100/100/100",
        "100/50/10",
        "100/10/1",
    ]
    assert (rows[0][0], rows[0][2]) == ("ned", "100/100/100")
    error = 1e-5 * STANDARD_GRAVITY / np.array([0.5, 1.0])  # 10 ug over the base
    assert_allclose(alone["level_lost_s"], np.sqrt(0.2 / error))
    for T in (10.0, 60.0):
        assert_allclose(alone[f"position_{T:g}_s_m"], STANDARD_GRAVITY * error * T**4 / 24.0, rtol=2e-3)
    assert_allclose(
        alone["position_then_m"], STANDARD_GRAVITY / 24.0 * error * np.square(0.2 / error), rtol=1e-3
    )
    *laws, strapdown = next(one for one in found.findings.figures if one.path[1] == "accelerometers").series
    assert (strapdown.t[0], strapdown.t[-1]) == (30.0, 3600.0)
    for line, one in zip(laws, error, strict=True):
        assert (line.t[0], line.t[-1]) == pytest.approx((10.0, 3600.0))
        assert_allclose(np.ravel(line.values)[:9], STANDARD_GRAVITY * one * line.t[:9] ** 4 / 24.0, rtol=2e-3)
    assert_allclose(
        np.ravel(strapdown.values)[:5], STANDARD_GRAVITY * error[1] * strapdown.t[:5] ** 4 / 24.0, rtol=0.01
    )


def test_what_an_algorithm_costs_by_hand(monkeypatch):
    """500 m off, turned by 3 and 4 arcsec about two axes, half a second for a thousand samples."""
    start = np.array([0.8, 0.2, 500.0, 10.0, -3.0, 1.0, *rotation.from_euler(0.2, -0.1, 2.0)])
    end, turn = start.copy(), np.deg2rad([3.0, 4.0, 0.0]) / 3600.0
    end[:3] = earth.displace(start[:3], np.array([300.0, 0.0, -400.0]))
    end[6:] = rotation.multiply(rotation.from_rotvec(turn), start[6:])
    motion = mechanization_costs.IntervalMotion(np.array([0.0, 10.0]), np.array([start, end]))
    monkeypatch.setattr(mechanization_costs, "navigate", lambda *given, **options: motion)
    seconds = iter([100.0, 100.5])
    monkeypatch.setattr(mechanization_costs.time, "process_time", lambda: next(seconds))
    flight = mechanization_costs.TrueFlight(
        np.tile(start, (1001, 1)), np.zeros((1000, 3)), np.zeros((1000, 3)), 0.01
    )
    found = flight.fly("ned")
    assert (found.position_m, found.attitude_arcsec) == pytest.approx((500.0, 5.0), rel=1e-4)
    assert found.step_us == pytest.approx(500.0)
    assert_allclose(flight.growth(motion), [0.0, 500.0], rtol=1e-4)


def test_series_are_as_good_as_the_register_says():
    assert radii_error("long") < 0.35
    assert 40 < radii_error("short", 0.0) < 46
    assert max(gravity_error("fine"), gravity_error("medium")) < 0.33
    assert 15 < gravity_error("simple") < 21


def test_12_the_strapdown_follows_the_law_of_accelerometers_alone(found):
    """g e t^4 / 24 at first and R e t^2 / 2 with Schuler's term later: within 1 % to half an hour."""
    t = np.array([60.0, 600.0, 1800.0])
    assert_allclose(simulate_accelerometers(t), drift_by_angular_acceleration(t, 1e-11), rtol=0.01)
    assert_allclose(simulate_accelerometers(t[:1]), simulate_accelerometers(t[:1], 0.25 * np.pi))  # at 45 deg
    assert acceleration_error(0.5, 1e-4) == pytest.approx(2e-4, rel=1e-9)  # bias over base
    lost = found.tables["accelerometers"].columns["level_lost_s"]
    assert lost[1] / lost[0] == pytest.approx(np.sqrt(2.0))
