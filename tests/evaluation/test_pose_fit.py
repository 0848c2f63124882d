"""Scale factors, misalignments and biases from poses, against those that were put in."""

import itertools

import numpy as np
import pytest

import bench
from bench.cli.command_line import main
from bench.core.mathematics import rotation
from bench.core.mathematics.units import STANDARD_GRAVITY
from bench.core.words.exceptions import ConfigError
from bench.evaluation.motion import pose_fit
from bench.io.parameters.measured_sheet import make_measured_spec, summarize_poses

RATE = 100.0
FACES = [(0, 0, 0), (90, 0, 0), (180, 0, 0), (270, 0, 0), (0, 90, 0), (0, -90, 0)]
"""Roll, pitch and heading [deg] that turn each axis up and down."""
TILTED = [*FACES, (45, 0, 0), (0, 45, 90), (135, 30, 0), (-45, -30, 60), (45, 45, 120), (-120, 50, 20)]
OFF = ~np.eye(3, dtype=bool)


def turn_by_hand(
    poses, seed, *, gravity=STANDARD_GRAVITY, skew=2e-3, turn_s=(1.5, 3.0), shake=0.5, earth_n=(0, 0, 0)
):
    """Return an IMU's readings while it is turned from pose to pose, and its errors.

    The turns are constant rotation vectors from one attitude to the next, with a shake of the hand.
    """
    rng = np.random.default_rng(seed)
    q = [rotation.from_euler(*np.deg2rad(one)) for one in poses]
    rates, course = [np.zeros((round(30.0 * RATE), 3))], [np.tile(q[0], (round(30.0 * RATE), 1))]
    for first, second in itertools.pairwise(q):
        phi = rotation.to_rotvec(rotation.multiply(rotation.conjugate(first), second))
        n = int(rng.uniform(*turn_s) * RATE)
        rates += [np.tile(phi * RATE / n, (n, 1)), np.zeros((round(6.0 * RATE), 3))]
        turned = rotation.from_rotvec(phi * np.arange(n)[:, None] / n)
        course += [rotation.multiply(first, turned), np.tile(second, (round(6.0 * RATE), 1))]
    w = np.concatenate(rates)
    force = rotation.rotate(rotation.conjugate(np.concatenate(course)), np.array([0.0, 0.0, -gravity]))
    force += (w != 0).any(axis=1)[:, None] * rng.normal(size=w.shape) * shake
    earth_b = rotation.rotate(rotation.conjugate(np.concatenate(course)), np.array(earth_n, float))
    angles = rng.normal(size=3) * skew
    yz, zx, xy = 0.5 * angles
    M_accel = np.array([[0, xy, zx], [xy, 0, yz], [zx, yz, 0]])
    np.fill_diagonal(M_accel, rng.normal(size=3) * 3e-3)
    M_gyro = rng.normal(size=(3, 3)) * 5e-3
    bias = rng.normal(size=(2, 3)) * [[5e-3], [0.1]]
    noise = rng.normal(size=(2, len(w), 3)) * np.sqrt(RATE) * np.array([1e-4, 1e-3])[:, None, None]
    read = {
        "gyro": (w + earth_b) @ (np.eye(3) + M_gyro).T + bias[0] + noise[0],
        "accel": force @ (np.eye(3) + M_accel).T + bias[1] + noise[1],
    }
    errors = {
        "gyro": (np.diag(M_gyro), M_gyro[OFF], bias[0]),
        "accel": (np.diag(M_accel), angles, bias[1]),
    }
    return read, errors


def fit(read, gravity=None):
    rests = pose_fit.find_rests(read, 1 / RATE)
    found = pose_fit.fit_poses(read, rests, 1 / RATE, gravity)
    return len(rests), {one.triad: one for one in found}


def list_hits(one, errors):
    """Return for each error whether its interval contains it."""
    return np.concatenate(
        [
            np.abs(one.scale - errors[0]) < one.scale_half,
            np.abs(one.angles - errors[1][: len(one.angles)]) < one.angles_half,
            np.abs(one.bias - errors[2]) < one.bias_half,
        ]
    )


def test_the_intervals_of_many_poses_hold():
    """20 units: 0.8 is the 99.9 % band of a part of 0.95 if all errors of a unit were one."""
    hits = {"gyro": [], "accel": []}
    for seed in range(20):
        read, errors = turn_by_hand(TILTED, seed)
        rests, found = fit(read)
        assert rests == len(TILTED)
        for triad, one in found.items():
            hits[triad].append(list_hits(one, errors[triad]).mean())
    assert {name: len(values) for name, values in hits.items()} == {"gyro": 20, "accel": 20}
    assert min(np.mean(values) for values in hits.values()) > 0.8
    assert found["accel"].scale_half.max() < 5e-4
    assert found["gyro"].scale_half.max() < 2e-3


def test_the_earth_rate_is_within_the_interval_of_a_gyro_bias():
    """A box that keeps its heading on a desk has a part of it in every mean, 15 deg/h at most."""
    rolled = [(roll, pitch, 0) for roll, pitch, _ in TILTED]
    for seed in range(10):
        read, errors = turn_by_hand(rolled, seed, earth_n=(5e-5, 0, -5e-5))
        gyro, _ = fit(read)[1].values()
        assert np.all(np.abs(gyro.bias - errors["gyro"][2]) < gyro.bias_half)
        assert gyro.bias_half.max() < 2e-4


def test_poses_about_one_axis_claim_nothing():
    read, _ = turn_by_hand([(roll, 0, 0) for roll in range(0, 360, 40)], 1)
    (one,) = fit(read)[1].values()
    assert not one.determined
    said = summarize_poses(one)
    assert said.endswith("(95 %): scale factors and biases not determined: turn each axis up and down")


def test_six_faces_give_scale_and_bias_and_claim_no_more():
    """The angles, which six faces do not determine, widen the intervals: they hold with axes 1 deg askew."""
    assert set(fit(turn_by_hand(TILTED[:8], 1)[0])[1]) == {"accel"}  # seven turns, between skewed directions
    hits = []
    for seed in range(20):
        read, errors = turn_by_hand(FACES, seed, skew=np.deg2rad(1.0))
        _, found = fit(read)
        assert set(found) == {"accel"}
        assert len(found["accel"].angles) == 0
        hits.append(list_hits(found["accel"], errors["accel"]).mean())
    assert np.mean(hits) > 0.8
    assert found["accel"].scale_half.max() < 1e-3


def test_slow_turns_are_no_rests():
    """Turns of 0.3 to 4 deg/s scatter as a rest does; a block of one within a rest would tilt its pose."""
    hits = []
    for seed in range(10):
        read, errors = turn_by_hand(TILTED, seed, turn_s=(40.0, 200.0), shake=0.0)
        rests = pose_fit.find_rests(read, 1 / RATE)
        assert [one.stop - one.start < 3050 for one in rests] == [True] * len(TILTED)
        hits.append(list_hits(fit(read)[1]["accel"], errors["accel"]).mean())
    assert np.mean(hits) > 0.8


def test_gyros_that_contradict_the_poses_are_left_out_with_their_reason():
    read, _ = turn_by_hand(TILTED, 4)
    for wrong in (read["gyro"][:, [1, 0, 2]], -read["gyro"], np.rad2deg(read["gyro"])):
        (one,) = fit({**read, "gyro": wrong})[1].values()
        assert one.missing.startswith("gyros not fitted: 11 turns do not rotate gravity from pose to pose")
    slow, _ = turn_by_hand(TILTED, 4, turn_s=(40.0, 50.0), shake=0.0)
    assert fit(slow)[1]["accel"].missing.startswith("gyros not fitted: 0 usable turns, 6 needed")


def test_gravity_is_the_scale_of_the_accelerometers():
    """By hand: a gravity taken 0.2 % too large makes every scale factor 0.2 % too small."""
    read, errors = turn_by_hand(TILTED, 5, gravity=9.787)
    right, wrong = (fit(read, g)[1]["accel"].scale for g in (9.787, 9.787 * 1.002))
    assert right == pytest.approx(errors["accel"][0], abs=3e-4)
    assert (1 + wrong) * 1.002 == pytest.approx(1 + right, abs=1e-6)


def write_table(path, read, degc=None, rows=slice(None)):
    names = [f"{of}_{axis}_{unit}" for of, unit in (("gyro", "rad_s"), ("accel", "m_s2")) for axis in "xyz"]
    table = np.column_stack([np.arange(len(read["gyro"])) / RATE, read["gyro"], read["accel"]])
    if degc is not None:
        names, table = [*names, "temperature_degc"], np.column_stack([table, degc])
    np.savetxt(path, table[rows], delimiter=",", header=",".join(["t_s", *names]), comments="")


def test_a_record_of_poses_becomes_a_datasheet(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    read, errors = turn_by_hand(TILTED, 7)
    write_table(tmp_path / "poses.csv", read)
    assert main(["allan", "--log", "poses.csv", "--gravity", "9.80665"]) == 0
    assert "accel, 12 poses 20 deg apart (95 %): bias " in capsys.readouterr().out
    sheet = bench.read_profile("figure-eight", {"sensors.imu": "unit-poses.toml"}).sensors.imu
    for triad, (scale, angles, bias) in errors.items():
        one = getattr(sheet, triad)
        angle = one.nonorthogonality_sd if triad == "accel" else one.misalignment_sd
        for got, put in ((one.scale_factor_sd, scale), (angle, angles), (one.turn_on_bias_sd, bias)):
            assert got == pytest.approx(np.sqrt(np.mean(put**2)), rel=0.2)
    assert "Not measured: range" in (tmp_path / "unit-poses.toml").read_text()


def test_an_error_that_is_not_significant_is_not_in_the_sheet(tmp_path):
    read, errors = turn_by_hand(TILTED, 7, skew=0.0)
    write_table(tmp_path / "poses.csv", read)
    fits = bench.measure_allan(log=tmp_path / "poses.csv").fits
    sheet = make_measured_spec("mine", fits, list(fit(read)[1].values()))
    assert sheet.accel.nonorthogonality_sd == 0.0
    assert sheet.accel.turn_on_bias_sd == pytest.approx(np.sqrt(np.mean(errors["accel"][2] ** 2)), rel=0.2)


def test_a_saturated_axis_is_refused(tmp_path):
    read, _ = turn_by_hand(TILTED, 7)
    write_table(tmp_path / "poses.csv", {**read, "gyro": np.clip(read["gyro"], -0.3, 0.3)})
    with pytest.raises(
        ConfigError, match=r"gyro_[xyz] has its (largest|smallest) value, -?0.3 rad/s, in .* saturated"
    ):
        bench.measure_allan(log=tmp_path / "poses.csv")


def test_a_change_of_temperature_between_poses_is_said(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    read, _ = turn_by_hand(TILTED, 7)
    for change, said in ((1.0, False), (5.0, True)):
        write_table(tmp_path / "poses.csv", read, np.linspace(20.0, 20.0 + change, len(read["gyro"])))
        assert main(["allan", "--log", "poses.csv", "--force"]) == 0
        assert (
            "the temperature changed by 5 K, so the biases may have changed" in capsys.readouterr().out
        ) == said


def test_five_poses_and_a_walk_are_refused_with_their_count(tmp_path):
    for poses, count in ((FACES[:5], 5), (FACES[:1] * 4, 1)):
        read, _ = turn_by_hand(poses, 3)
        read["gyro"][3000:] += 0.1 * np.sin(np.arange(len(read["gyro"]) - 3000))[:, None]
        read["gyro"][:, 0] += np.where(np.arange(len(read["gyro"])) % 1000 < 300, 0.5, 0.0)
        write_table(tmp_path / "few.csv", read)
        with pytest.raises(ConfigError, match=rf"gyro_x moves: .* \(found: [0-{count}]\)"):
            bench.measure_allan(log=tmp_path / "few.csv")


def test_gravity_has_no_use_in_one_pose(tmp_path):
    read, _ = turn_by_hand(FACES[:1], 3)
    write_table(tmp_path / "desk.csv", read)
    with pytest.raises(ConfigError, match=r"rests in one pose, so --gravity has no effect; leave it out"):
        bench.measure_allan(log=tmp_path / "desk.csv", gravity=9.81)
    with pytest.raises(ConfigError, match=r"--gravity is for a log with several poses"):
        bench.measure_allan("stim300", gravity=9.81)
