"""Datasheets that recordings hold, against figures worked out by hand."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.io import savemat

from bench.core.files.places import PACKAGE
from bench.io.config.datasheets import SENSORS, read_imu
from bench.io.logs.found_datasheets import read_imu_sheet, write_baro_sheet

ROW = np.ones((1, 3))


def read_back(tmp_path, **fields):
    savemat(tmp_path / "x.mat", {"imu": {"t": np.arange(4.0), **fields}})
    text = read_imu_sheet(tmp_path / "x.mat", "imu")
    (tmp_path / "sheet.toml").write_text(text)
    return text, read_imu(tmp_path / "sheet.toml", "sheet.toml") if text else None


def test_every_figure_is_taken_in_its_unit(tmp_path):
    """SI there and SI here; a bias instability is the peak 0.617 sd of a Gauss-Markov process."""
    _, spec = read_back(
        tmp_path, arw=1e-4 * ROW, vrw=2e-3 * ROW, arrw=1e-7 * ROW, vrrw=3e-6 * ROW,
        gb_dyn=1e-5 * ROW, gb_corr=200.0 * ROW, ab_dyn=4e-4 * ROW, ab_corr=300.0 * ROW,
        gb_sta=1e-3 * ROW, ab_sta=0.05 * ROW,
    )  # fmt: skip
    gyro, accel = spec.gyro, spec.accel
    assert (gyro.random_walk, accel.random_walk) == pytest.approx((1e-4, 2e-3))
    assert (gyro.rate_random_walk, accel.rate_random_walk) == pytest.approx((1e-7, 3e-6))
    assert (gyro.instability_sd, accel.instability_sd) == pytest.approx((1e-5, 4e-4))
    assert (gyro.bias_correlation, accel.bias_correlation) == pytest.approx((200.0, 300.0))
    assert (gyro.turn_on_bias_sd, accel.turn_on_bias_sd) == pytest.approx((1e-3, 0.05))
    assert gyro.bias_model == accel.bias_model == "gauss-markov"


def test_axes_keep_their_own_figures(tmp_path):
    _, spec = read_back(tmp_path, arw=np.array([[1e-4, 2e-4, 3e-4]]), vrw=2e-3)
    assert spec.gyro.by_axis("random_walk") == pytest.approx([1e-4, 2e-4, 3e-4])
    assert spec.accel.by_axis("random_walk") == pytest.approx([2e-3] * 3)


def test_what_is_no_figure_is_left_out_and_named(tmp_path):
    text, spec = read_back(
        tmp_path, arw=1e-4 * ROW, vrw=2e-3 * ROW, gb_dyn=0.0 * ROW, ab_dyn=np.array([[1e-4, np.nan, 1e-4]]),
        gb_corr=np.inf * ROW, gb_sta="none", ab_sta=np.ones((2, 3)), vrrw=-1.0,
    )  # fmt: skip
    assert spec.gyro.bias_instability == spec.accel.bias_instability == 0.0
    assert spec.gyro.turn_on_bias_sd == spec.accel.turn_on_bias_sd == 0.0
    first = text.splitlines()[1]
    assert first.startswith("# Not in the file: ")
    assert "gyro.turn_on_bias_sd" in first


@pytest.mark.parametrize("fields", [{}, {"arw": 1e-4 * ROW}, {"arw": 0.0 * ROW, "vrw": 1e-3 * ROW}])
def test_without_the_white_noise_of_both_triads_there_is_no_sheet(tmp_path, fields):
    assert read_back(tmp_path, **fields) == ("", None)


def test_a_barometer_is_as_noisy_as_the_autopilot_assumes(tmp_path):
    (tmp_path / "b.toml").write_text(write_baro_sheet(tmp_path / 'a"b.bin', 3.5, "EKF2_BARO_NOISE", "bmp388"))
    spec = SENSORS["baro"](tmp_path / "b.toml", "b.toml")
    like = SENSORS["baro"](PACKAGE / "catalog" / "baro" / "bmp388.toml", "bmp388")
    assert (spec.white_sd, like.white_sd) == (3.5, 0.1)
    assert (spec.bias_sd, spec.bias_walk, spec.rate) == (like.bias_sd, like.bias_walk, like.rate)
