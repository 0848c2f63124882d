"""The satellites in the recording: a banked aircraft loses those on the side of its raised wing, and what
stands in the file is what the receiver had."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from bench.core.mathematics import rotation
from bench.core.records.run_result import RunResult
from bench.core.records.sensor_specs import Fault
from bench.io import config
from bench.simulation.sensors import sense
from bench.views.recording import column, sky_view, write
from tests.synthetic import still

BANK = np.deg2rad(60.0)  # right wing down: what the antenna loses is to the left


@pytest.fixture(scope="module")
def profile():
    fault = Fault("jamming", "gnss", 50.0, 55.0, "jamming of gnss", loss=60.0)
    read = config.read_profile("figure-eight", {"sensors.gnss": "sky-l1"})
    return replace(read, sensors=replace(read.sensors, gnss_outages=(), faults=(fault,)))


@pytest.fixture(scope="module")
def truth():
    """Level, heading north; banked from 20 to 40 s."""
    level = still(60.0, 20.0, attitude=(0.0, 0.0, 0.0))
    q_nb = np.array(level.q_nb)
    q_nb[(level.t >= 20.0) & (level.t < 40.0)] = rotation.from_euler(BANK, 0.0, 0.0)
    return replace(level, q_nb=q_nb)


@pytest.fixture(scope="module")
def sensed(profile, truth):
    return sense(truth, profile.sensors, 1, 0)


def at(sky, t):
    rows = np.abs(sky.t - t) < 1e-6
    return {name: getattr(sky, name)[rows] for name in ("sat", "azimuth", "elevation", "cn0", "used")}


def test_a_banked_antenna_loses_the_satellites_beyond_its_edge(profile, sensed):
    """By spherical geometry: elevation over the antenna's plane, from the bank alone."""
    level, banked = at(sensed.sky, 10.0), at(sensed.sky, 30.0)
    assert level["used"].all()
    assert len(banked["used"]) == len(level["used"])  # all still stand in the sky
    el, az = banked["elevation"], banked["azimuth"]
    over_plane = np.arcsin(np.sin(el) * np.cos(BANK) + np.cos(el) * np.sin(az) * np.sin(BANK))
    assert_array_equal(np.isfinite(banked["cn0"]), over_plane >= profile.sensors.gnss.sky.antenna_mask)
    lost = ~np.isfinite(banked["cn0"])
    assert lost.sum() >= 3
    assert (np.sin(az[lost]) < 0).all()  # west: the left wing is up
    assert not banked["used"][lost].any()


def make_result(profile, truth, sensed):
    return RunResult(
        profile=profile.document,
        seed=profile.seed,
        run=0,
        metrics={},
        errors={},
        solutions={},
        provenance={},
        more={"scene": {"mesh": "uav", "antenna_mask_deg": 0.0}},
        records={"truth": truth, "sensed": sensed},
    )


def test_under_a_jammer_the_satellites_are_there_and_not_received(sensed):
    jammed = at(sensed.sky, 52.0)
    assert len(jammed["sat"]) == len(at(sensed.sky, 49.0)["sat"]) > 10
    assert not np.isfinite(jammed["cn0"]).any()
    assert not jammed["used"].any()


def test_used_satellites_are_those_of_the_fixes(sensed):
    sky, fixes = sensed.sky, sensed.data.fixes
    counts = [at(sky, t)["used"].sum() for t in fixes.t]
    assert_array_equal(counts, fixes.satellites)


def test_the_recording_holds_them(profile, truth, sensed, tmp_path):
    path = tmp_path / "flight.rrd"
    write(path, profile.name, make_result(profile, truth, sensed))
    t, used = column(path, "/satellites/number/used", "Scalars:scalars")
    assert_allclose(t, np.arange(1.0, 61.0), atol=1e-6)
    assert used[29, 0] == at(sensed.sky, 30.0)["used"].sum() < used[9, 0]
    o = sensed.data.observations
    mine = (o.system == 0) & (o.sat == o.sat[0])
    t, strength = column(path, f"/satellites/cn0/GPS/G{o.sat[0]:02d}", "Scalars:scalars")
    there = np.isfinite(strength[:, 0])
    assert_allclose(t[there], o.t[mine], atol=1e-6)
    assert_allclose(strength[there, 0], o.cn0[mine, 0])
    t, dop = column(path, "/satellites/dop/dop", "Scalars:scalars")
    assert dop[29, 0] > dop[9, 0] > 0
    assert np.isnan(dop[51]).all()
    from rerun.chunk import RrdReader

    counts = {}
    for chunk in RrdReader(path).stream():
        if chunk.entity_path == "/sky/satellites" and not chunk.is_static:
            batch = chunk.to_record_batch()
            times = batch.column("flight_time").cast("int64").to_numpy() * 1e-9
            labels = batch.column("Points2D:labels").to_pylist()
            counts |= dict(zip(np.round(times, 6), map(set, labels), strict=True))
    assert counts[0.0] == counts[1.0]  # a recording opens at 0, before the first epoch
    here = at(sensed.sky, 30.0)
    assert len(counts[30.0]) == len(here["sat"])
    assert {f"G{n:02d}" for n in (6, 10)} <= counts[30.0]


def test_the_sky_plot_has_north_up_and_east_right():
    places = sky_view.place(
        np.array([0.0, 0.0, np.pi / 2, np.pi / 4]), np.array([0.0, np.pi / 2, 1.0, np.pi])
    )
    assert_allclose(places, [[0, -1], [1, 0], [0, 0], [0, 0.5]], atol=1e-12)  # the viewer's y points down


def test_faults_are_hatched_and_named(profile, truth, sensed, tmp_path):
    path = tmp_path / "flight.rrd"
    write(path, profile.name, make_result(profile, truth, sensed))
    t, _ = column(path, "/satellites/dop/behind/fault", "Scalars:scalars")
    assert t.min() == pytest.approx(50.0)
    assert t.max() == pytest.approx(55.0, abs=1e-5)
