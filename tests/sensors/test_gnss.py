"""The position-level receiver: where the antenna is, how its errors remember, and when it is silent.

Statistical bounds are two-sided 99.9 % bands of the statistic itself, over independent runs.
"""

from __future__ import annotations

import re
from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

import bench
from bench.core.mathematics import earth, rotation
from bench.core.records.sensor_specs import GnssSpec
from bench.core.words.exceptions import ConfigError
from bench.io.config.datasheets import read_gnss
from bench.navigation.error_state_filter.aiding_sensors import fix_variance
from bench.navigation.models.classic.process_model import per_axis
from bench.simulation.sensors import gnss
from bench.simulation.sensors.draws import SensorDraws
from bench.simulation.sensors.measurement_level import sky
from tests.builders import band
from tests.sensors.given_numbers import respond
from tests.synthetic import ORIGIN, still, turning

CATALOG = Path(bench.__file__).parent / "catalog" / "gnss"
LEVER = (1.5, -0.4, -0.8)
SILENT = GnssSpec("silent", rate=1.0, pos_h_white_sd=0.0, pos_v_white_sd=0.0, vel_white_sd=0.0)
FULL = GnssSpec(
    "full",
    rate=1.0,
    pos_h_white_sd=2.0,
    pos_v_white_sd=3.0,
    vel_white_sd=0.03,
    pos_h_markov_sd=6.0,
    pos_v_markov_sd=8.0,
    vel_markov_sd=0.1,
    pos_decay_distance=4e-6,
    pos_decay_time=5e-4,
    vel_decay_time=0.01,
)


@pytest.fixture(scope="module")
def turn():
    return turning(60.0, 200.0)


def measure(truth, spec, antenna_b=(0.0, 0.0, 0.0), outages=(), seed=1, run=0):
    return gnss.measure(truth, spec, antenna_b, outages, SensorDraws(seed, run))


def errors(truth, spec, **options):
    """Position and velocity error of every fix [m, m/s], n."""
    fixes, exact = measure(truth, spec, **options), measure(truth, silence(spec), **options)
    return earth.difference_n(fixes.lla, exact.lla), fixes.vel_n - exact.vel_n


def silence(spec):
    return replace(SILENT, rate=spec.rate)


def test_without_errors_a_fix_is_the_antenna(turn):
    """Position from the Earth-fixed sum, velocity from central differences of that sum.

    The difference to the IMU is compared, so that the synthetic circle's own 1e-5 cancels. Left out,
    the Earth rate in the lever-arm velocity (1e-4 m/s) would be seen.
    """
    fixes = measure(turn, SILENT, antenna_b=LEVER)
    rows = np.searchsorted(turn.t, fixes.t)
    assert_allclose(fixes.t, np.arange(1, 61), atol=1e-9)
    C_en = earth.matrix_en(turn.lla[:, 0], turn.lla[:, 1])
    lever_e = np.einsum("kij,kj->ki", C_en, rotation.rotate(turn.q_nb, np.array(LEVER)))
    assert_allclose(earth.to_ecef(fixes.lla), (earth.to_ecef(turn.lla) + lever_e)[rows], rtol=0, atol=1e-6)

    rows = rows[:-1]  # the last epoch has no later neighbor
    rate_e = (lever_e[rows + 1] - lever_e[rows - 1]) / (turn.t[rows + 1] - turn.t[rows - 1])[:, None]
    lever_rate_n = np.einsum("kji,kj->ki", C_en[rows], rate_e)
    assert_allclose(fixes.vel_n[:-1] - turn.vel_n[rows], lever_rate_n, rtol=0, atol=2e-5)
    assert np.abs(lever_rate_n).max() > 0.3
    assert earth.EARTH_RATE * np.linalg.norm(LEVER) > 5 * 2e-5


def test_the_turn_rate_of_an_instant_is_centered_on_it(turn):
    """Under a steady roll acceleration the mean of both neighbors is exact; one alone is dt / 2 late."""
    acceleration = 2.0
    ramp = acceleration * 0.5 * (turn.t[1:] ** 2 - turn.t[:-1] ** 2)
    still_rate = replace(turn, dtheta_b=np.zeros_like(turn.dtheta_b))
    rolling = replace(turn, dtheta_b=np.column_stack([ramp, np.zeros((len(ramp), 2))]))
    gained_n = measure(rolling, SILENT, LEVER).vel_n - measure(still_rate, SILENT, LEVER).vel_n
    rows = np.searchsorted(turn.t, np.arange(1, 60) - 1e-6)
    w_b = np.column_stack([acceleration * turn.t[rows], np.zeros((len(rows), 2))])
    expected_n = rotation.rotate(turn.q_nb[rows], np.cross(w_b, LEVER))
    assert_allclose(gained_n[:-1], expected_n, rtol=0, atol=1e-9)


def test_without_lever_arm_a_fix_is_the_imu(turn):
    fixes = measure(turn, SILENT)
    rows = np.searchsorted(turn.t, fixes.t)
    assert_array_equal(fixes.lla, turn.lla[rows])
    assert_array_equal(fixes.vel_n, turn.vel_n[rows])


def test_doubling_the_lever_arm_doubles_the_offset(turn):
    imu = measure(turn, SILENT).vel_n
    once, twice = (measure(turn, SILENT, antenna_b=tuple(k * np.array(LEVER))).vel_n for k in (1, 2))
    assert_allclose(twice - imu, 2 * (once - imu), rtol=0, atol=1e-12)


def test_the_vertical_velocity_may_have_white_noise_of_its_own(turn):
    """In the errors, the covariance that is reported, and R; left out it is that of each other axis."""
    alike, own = replace(SILENT, vel_white_sd=0.02), replace(SILENT, vel_white_sd=0.02, vel_v_white_sd=0.06)
    before, after = errors(turn, alike)[1], errors(turn, own)[1]
    assert_allclose(after, before * [1.0, 1.0, 3.0], rtol=0, atol=1e-12)
    assert_allclose(measure(turn, own).cov_vel_n[0], np.diag([4e-4, 4e-4, 36e-4]), rtol=1e-12)
    for filters_r in (fix_variance(own, gnss_markov=True), fix_variance(own, gnss_markov=False)):
        assert_allclose(filters_r[3:], [4e-4, 4e-4, 36e-4], rtol=1e-12)
    assert_allclose(per_axis((1.0, 2.0, 0.02, 0.06)), [1.0, 1.0, 2.0, 0.02, 0.02, 0.06])


@pytest.mark.parametrize(
    ("figure", "quantity", "axes"),
    [
        ("pos_h_white_sd", 0, [0, 1]),
        ("pos_v_white_sd", 0, [2]),
        ("vel_white_sd", 1, [0, 1, 2]),
        ("pos_h_markov_sd", 0, [0, 1]),
        ("pos_v_markov_sd", 0, [2]),
        ("vel_markov_sd", 1, [0, 1, 2]),
    ],
)
def test_doubling_an_error_doubles_it_alone(turn, figure, quantity, axes):
    """The term alone doubles; beside all others it adds what it is alone; other columns keep their bits."""
    decays = {"pos_decay_distance": 4e-6, "pos_decay_time": 5e-4, "vel_decay_time": 0.01}
    value = getattr(FULL, figure)
    alone = errors(turn, replace(SILENT, **decays, **{figure: value}))[quantity]
    doubled = errors(turn, replace(SILENT, **decays, **{figure: 2 * value}))[quantity]
    others = [axis for axis in range(3) if axis not in axes]
    assert np.abs(alone[:, axes]).min() > 0
    assert_allclose(doubled, 2 * alone, rtol=0, atol=1e-7)
    assert_allclose(alone[:, others], 0, atol=1e-7)

    before, after = measure(turn, FULL), measure(turn, replace(FULL, **{figure: 2 * value}))
    columns = [(earth.difference_n(after.lla, before.lla)), after.vel_n - before.vel_n]
    assert_allclose(columns[quantity], alone, rtol=0, atol=1e-4)
    assert_array_equal(columns[1 - quantity], 0)
    assert_array_equal(columns[quantity][:, others], 0)


def test_every_noise_has_a_stream_and_none_is_drawn_for_nothing(turn, streams_drawn):
    drawn = streams_drawn()
    measure(turn, SILENT)
    assert drawn == []
    measure(turn, FULL)
    assert sorted(drawn) == [
        "gnss.position.markov",
        "gnss.position.white",
        "gnss.velocity.markov",
        "gnss.velocity.white",
    ]


def test_white_errors_have_their_size_in_meters_on_every_axis():
    """At 47 degrees latitude, so that a missing cosine would be seen on the east axis."""
    white = replace(FULL, pos_h_markov_sd=0.0, pos_v_markov_sd=0.0, vel_markov_sd=0.0)
    pos, vel = errors(still(3000.0, 1.0), white)
    low, high = band(len(pos))
    for axis, sd in enumerate([2.0, 2.0, 3.0]):
        assert low < np.mean(pos[:, axis] ** 2) / sd**2 < high
        assert low < np.mean(vel[:, axis] ** 2) / 0.03**2 < high
    assert not low < 1 / np.cos(ORIGIN[0]) ** 2 < high


@pytest.mark.parametrize(("speed", "tau"), [(250.0, 2000.0 / 3), (0.0, 2000.0)])
def test_markov_error_forgets_by_distance_and_time(speed, tau):
    """Equations #21, by each of its numbers alone: 1/e after 667 s at 250 m/s, 2000 s at rest."""
    truth = turning(tau, 12 / tau, speed=speed, turn_rate=1e-3)
    spec = replace(
        SILENT, rate=12 / tau, pos_h_markov_sd=6.0, pos_v_markov_sd=8.0,
        pos_decay_distance=4e-6, pos_decay_time=5e-4,
    )  # fmt: skip
    exact = measure(truth, silence(spec)).lla

    def err(draws):
        return earth.difference_n(gnss.measure(truth, spec, (0.0, 0.0, 0.0), (), draws).lla, exact)

    response, t = respond("gnss.position.markov", 36, err), truth.t[1:]
    expected = np.kron(np.exp(-np.abs(np.subtract.outer(t, t)) / tau), np.diag([36.0, 36.0, 64.0]))
    assert_allclose(response @ response.T, expected, rtol=0, atol=1e-3)


@pytest.mark.parametrize("figure", ["pos_decay_distance", "pos_decay_time", "vel_decay_time"])
def test_doubling_a_decay_shortens_the_memory(figure):
    """Same first error, larger steps: with one decay alone, by the square root of 2."""
    truth = turning(600.0, 1.0)
    off = dict.fromkeys(["pos_decay_distance", "pos_decay_time", "vel_decay_time"], 0.0)
    spec = replace(SILENT, pos_h_markov_sd=6.0, pos_v_markov_sd=6.0, vel_markov_sd=0.1)
    quantity = 1 if figure == "vel_decay_time" else 0
    value = {"pos_decay_distance": 4e-6, "pos_decay_time": 1e-4, "vel_decay_time": 1e-4}[figure]
    once, twice = (errors(truth, replace(spec, **{**off, figure: k * value}))[quantity] for k in (1, 2))
    assert_allclose(twice[0], once[0], rtol=0, atol=1e-7)
    steps = [np.diff(error, axis=0).std() for error in (once, twice)]
    assert_allclose(steps[1] / steps[0], np.sqrt(2), rtol=0.01)


def test_reported_covariance_is_the_total(turn):
    fixes = measure(turn, FULL)
    total = np.diag([2.0**2 + 6.0**2, 2.0**2 + 6.0**2, 3.0**2 + 8.0**2])
    assert_allclose(fixes.cov_pos_n, np.broadcast_to(total, fixes.cov_pos_n.shape), rtol=1e-12)
    assert_allclose(fixes.cov_vel_n, np.broadcast_to(0.0109 * np.eye(3), fixes.cov_vel_n.shape), rtol=1e-12)
    assert (fixes.satellites == gnss.SATELLITES_UNKNOWN).all()
    assert fixes.valid.all()


def test_an_outage_is_half_open_and_changes_no_other_fix(turn):
    whole = measure(turn, FULL, antenna_b=LEVER)
    broken = measure(turn, FULL, antenna_b=LEVER, outages=((20.0, 30.0), (45.5, 46.5)))
    kept = ~(((whole.t > 19.9) & (whole.t < 29.9)) | ((whole.t > 45.4) & (whole.t < 46.4)))
    assert 20.0 not in np.round(broken.t)
    assert {19.0, 30.0, 45.0, 47.0} <= set(np.round(broken.t))
    assert 46.0 not in np.round(broken.t)
    assert_array_equal(broken.t, whole.t[kept])
    assert_array_equal(broken.lla, whole.lla[kept])
    assert_array_equal(broken.vel_n, whole.vel_n[kept])


def test_an_outage_ends_on_its_instant_when_times_are_rounded(turn):
    """A time column summed up sample by sample misses 30 s by rounding; the fix at 30 s still comes."""
    summed = replace(turn, t=np.cumsum(np.full(len(turn), 0.005)) - 0.005)
    at_30 = summed.t[6000]
    assert at_30 != 30.0
    for end in (30.0, at_30):
        broken = measure(summed, SILENT, outages=((20.0, end),))
        assert_allclose(broken.t[18:20], [19.0, 30.0], atol=1e-9)


def test_latency_moves_the_arrival_only(turn):
    prompt = measure(turn, FULL)
    for latency in (0.1, 0.2):
        late = measure(turn, replace(FULL, latency=latency))
        assert_allclose(late.t_arrival - late.t, latency, atol=1e-12)
        assert_array_equal(late.t, prompt.t)
        assert_array_equal(late.lla, prompt.lla)


def test_doubling_the_rate_doubles_the_fixes(turn):
    assert [len(measure(turn, replace(FULL, rate=rate))) for rate in (1.0, 2.0, 10.0)] == [60, 120, 600]
    uneven = measure(turn, replace(FULL, rate=18.0))  # 200 / 18 is no whole number
    assert len(uneven) == 1080
    assert np.isin(uneven.t, turn.t).all()
    assert_allclose(uneven.t, np.arange(1, 1081) / 18.0, atol=1.0 / 200 + 1e-9)


def test_a_rate_the_truth_cannot_give_is_refused(turn):
    with pytest.raises(ValueError, match="gnss: rate 400 Hz is above the 200 Hz of the truth"):
        measure(turn, replace(FULL, rate=400.0))
    assert len(measure(turn, replace(FULL, rate=0.01))) == 0  # `sense` rejects what never says anything


JUMPS = {
    "pos_h_jump_sd": 2.5,
    "pos_v_jump_sd": 3.75,
    "vel_jump_sd": 0.06,
    "pos_h_jump_markov_sd": 3.5,
    "pos_v_jump_markov_sd": 5.0,
    "vel_jump_markov_sd": 0.015,
}


@pytest.fixture(scope="module")
def day():
    return still(86160.0, 0.1)


def test_the_constellation_changes_when_a_satellite_crosses_five_degrees(day):
    """By the kernel of the measurement-level receiver; 24 satellites come and go about twice a day."""
    from bench.core.records.sky_spec import SkySpec
    from bench.simulation.sensors.measurement_level.view import compute_view

    rows = np.arange(1, len(day.t))

    def no_loss(system, sat):
        return np.empty((0, len(sat)))

    names = [f for f in SkySpec.__slots__ if f not in ("orbits", "klobuchar", "systems")]
    sky = SkySpec(**dict.fromkeys(names, 0.0), orbits=None, klobuchar=(0.0,) * 8, systems="gps")
    sky = replace(sky, elevation_mask=np.deg2rad(5.0), antenna_mask=-np.pi / 2)
    seen = compute_view(
        day, rows, sky, (0.0, 0.0, 0.0), lambda system, sat: np.empty((0, len(sat))), SensorDraws(1, 0)
    )
    up = np.zeros((len(rows), 24), bool)
    gps = seen.system[seen.which] == 0
    up[seen.epoch[gps], seen.sat[seen.which[gps]] - 1] = True
    expected = (up[1:] != up[:-1]).any(axis=1)
    changed = gnss.find_constellation_changes(day.t[rows], day.lla[rows])
    assert not changed[0]
    assert 60 < expected.sum() < 150
    assert abs(changed[1:].sum() - expected.sum()) <= 1
    assert (changed[1:] == expected).mean() > 0.9995  # an epoch apart where the travel time decides


def test_jumps_at_constellation_changes_have_their_rms(day):
    """#22: sqrt(sigma_dc^2 + sigma_ds^2) within 5 % over more than 1000 events; in between nothing jumps."""
    spec = replace(SILENT, rate=0.1, pos_decay_time=5e-4, vel_decay_time=0.01, **JUMPS)
    at = np.flatnonzero(gnss.find_constellation_changes(day.t[1:], day.lla[1:]))
    kept = np.exp(-np.array([5e-4, 0.01]) * 10.0)
    found = [[], []]
    for run in range(16):
        for k, error in enumerate(errors(day, spec, run=run)):
            alone = at[~np.isin(at - 1, at) & (at > 0)]
            found[k].append(error[alone] - kept[k] * error[alone - 1])
            quiet = ~np.isin(np.arange(1, len(error)), np.concatenate([at, at + 1]))
            assert np.abs(error[1:] - kept[k] * error[:-1])[quiet].max() < 1e-6
    expected = [np.hypot([2.5, 2.5, 3.75], [3.5, 3.5, 5.0]), np.full(3, np.hypot(0.06, 0.015))]
    for jumps, sd in zip(found, expected, strict=True):
        jumps = np.concatenate(jumps)
        assert len(jumps) >= 1000
        low, high = band(jumps.size)
        assert 0.95**2 < low < high < 1.05**2
        ratio = np.mean((jumps / sd) ** 2)
        assert low < ratio < high
        assert not low < ratio * 1.1**2 < high


@pytest.mark.parametrize("figure", JUMPS)
def test_each_jump_has_its_own_share_and_its_own_stream(day, figure):
    """Twice the figure, twice its jumps, and every other noise keeps its bits."""
    noisy = replace(FULL, rate=0.1, **JUMPS)
    once, twice = (replace(noisy, **{figure: k * JUMPS[figure]}) for k in (1, 2))
    without = replace(noisy, **{figure: 0.0})
    base, one, two = (measure(day, spec) for spec in (without, once, twice))
    quantity = (
        (lambda f: f.vel_n) if figure.startswith("vel") else (lambda f: earth.difference_n(f.lla, base.lla))
    )
    added = [quantity(f) - quantity(base) for f in (one, two)]
    assert np.abs(added[0]).max() > 0.5 * JUMPS[figure]
    assert_allclose(added[1], 2 * added[0], rtol=0, atol=1e-3 * JUMPS[figure])
    alone = errors(
        day,
        replace(
            silence(noisy),
            pos_decay_distance=4e-6,
            pos_decay_time=5e-4,
            vel_decay_time=0.01,
            **{figure: JUMPS[figure]},
        ),
    )
    assert_allclose(alone[figure.startswith("vel")], added[0], rtol=0, atol=1e-3 * JUMPS[figure])
    other = [f.lla if figure.startswith("vel") else f.vel_n for f in (base, one)]
    assert_array_equal(*other)


def test_an_optimistic_receiver_reports_less_than_it_errs(turn):
    """Same fixes, smaller covariance: by the square of the factor it states."""
    honest, bold = measure(turn, FULL), measure(turn, replace(FULL, optimism=2.0))
    assert_array_equal(bold.lla, honest.lla)
    assert_allclose(bold.cov_pos_n, honest.cov_pos_n / 4, rtol=1e-12)
    assert_allclose(bold.cov_vel_n, honest.cov_vel_n / 4, rtol=1e-12)


def test_presets_are_the_ends_and_the_middle_of_the_source():
    """A-5.2.2, all ranges: position, height, velocity; white, Markov, jumps."""
    best, worst, middle, plain = (
        read_gnss(CATALOG / f"{name}.toml", name)
        for name in ("l1-code-best", "l1-code-worst", "l1-code-jumps", "l1-code")
    )
    ranges = {
        "pos_h_white_sd": (1, 3), "pos_v_white_sd": (1.5, 4), "vel_white_sd": (0.01, 0.05),
        "pos_h_markov_sd": (5, 7), "pos_v_markov_sd": (7, 10), "vel_markov_sd": (0.02, 0.3),
        "pos_h_jump_sd": (1, 4), "vel_jump_sd": (0.02, 0.2), "pos_h_jump_markov_sd": (2, 5),
        "pos_v_jump_markov_sd": (3, 7), "vel_jump_markov_sd": (0.01, 0.02),
    }  # fmt: skip
    for name, (low, high) in ranges.items():
        assert (getattr(best, name), getattr(worst, name)) == (low, high), name
        assert low < getattr(middle, name) < high
    assert_allclose([best.vel_decay_time, worst.vel_decay_time], [0.05, 0.0017], rtol=1e-3)
    off = dict.fromkeys(JUMPS, 0.0)
    assert replace(middle, name="", **off) == replace(plain, name="")


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ("pos_decay_time_s = 2000.0\n", "", "pos_h_jump_markov_sd_m needs pos_decay_distance_km or"),
        ("vel_decay_time_s = 108.0\n", "", "[gnss] vel_jump_markov_sd_mps needs vel_decay_time_s"),
        ("rate_hz = 1.0\n", "rate_hz = 1.0\noptimism = 50.0\n", "[gnss] optimism = 50 is outside 0.05 to 20"),
        ("pos_h_jump_sd_m", "pos_h_jumps_sd_m", "unknown key 'pos_h_jumps_sd_m'. Did you mean"),
    ],
)  # fmt: skip
def test_a_wrong_jump_gets_one_line(tmp_path, old, new, said):
    text = (
        (CATALOG / "l1-code-jumps.toml")
        .read_text(encoding="utf-8")
        .replace("pos_decay_distance_km = 250.0\n", "")
    )
    text = text.partition("[sources]")[0]
    assert old in text
    path = tmp_path / "mine.toml"
    path.write_text(text.replace(old, new), encoding="utf-8")
    with pytest.raises(ConfigError, match=re.escape(said)):
        read_gnss(path, "mine.toml")


def test_a_sky_makes_its_own_jumps(tmp_path):
    text = (CATALOG / "sky-l1.toml").read_text(encoding="utf-8")
    text = text.replace("[sky]\n", "pos_h_jump_sd_m = 2.0\n\n[sky]\n", 1)
    (tmp_path / "mine.toml").write_text(text, encoding="utf-8")
    with pytest.raises(ConfigError, match=r"\[sky\] makes the jumps; leave out the"):
        read_gnss(tmp_path / "mine.toml", "mine.toml")


# --- acceleration: #31 --------------------------------------------------------------------------------------


def stepping(a=2.0 * 9.80665, begin=2.0, end=8.0, rate=200.0):
    """Ten seconds whose velocity has a constant acceleration north from begin to end [s]; nothing turns."""
    truth = still(10.0, rate)
    vel_n = np.zeros((len(truth.t), 3))
    vel_n[:, 0] = a * (np.clip(truth.t, begin, end) - begin)
    return replace(truth, vel_n=vel_n)


def lag_of(truth, bandwidth, antenna_b=(0.0, 0.0, 0.0), pieces=1):
    """Position and velocity error [m, m/s] of a receiver at 20 Hz that has no other, flown in pieces."""
    spec, found, draws = replace(SILENT, rate=20.0, tracking_bandwidth=bandwidth), [], SensorDraws(1, 0)
    exact = measure(truth, replace(SILENT, rate=20.0), antenna_b)
    ends = np.linspace(0, len(truth.t) - 1, pieces + 1).round().astype(int)
    for first, last in pairwise(ends):
        rows = slice(first, last + 1)
        part = replace(
            truth,
            **{name: getattr(truth, name)[rows] for name in ("t", "lla", "vel_n", "q_nb")},
            **{name: getattr(truth, name)[first:last] for name in ("dtheta_b", "dvel_b")},
        )
        found.append(gnss.measure(part, spec, antenna_b, (), draws))
    lla, vel_n = (np.concatenate([getattr(one, name) for one in found]) for name in ("lla", "vel_n"))
    return exact.t, earth.difference_n(lla, exact.lla), vel_n - exact.vel_n


@pytest.mark.parametrize("bandwidth", [0.4, 3.0])
def test_31_a_step_of_2_g_leaves_the_loops_behind_as_the_closed_form_says(bandwidth):
    """a / w^2 (1 - e^-st (cos st + sin st)), s = w / sqrt(2), w = B / 0.53, and its rate."""
    a, w = 2.0 * 9.80665, bandwidth * 8.0 / (3.0 * np.sqrt(2.0))
    assert w == pytest.approx(bandwidth / 0.53, rel=1e-3)
    t, pos, vel = lag_of(stepping(a), bandwidth)
    s = w / np.sqrt(2.0)
    x = np.maximum(t - 2.0, 0.0)
    rising, after = t < 8.0 - 1e-9, t > 9.9
    behind = a / w**2 * (1.0 - np.exp(-s * x) * (np.cos(s * x) + np.sin(s * x)))
    rate = a / s * np.exp(-s * x) * np.sin(s * x)
    assert_allclose(pos[rising, 0], -behind[rising], atol=2e-5)  # rounding of latitude and the ellipsoid
    assert_allclose(vel[rising, 0], -rate[rising], atol=1e-9)
    assert_allclose(pos[:, 1:], 0.0, atol=1e-6)
    if bandwidth == 3.0:
        assert pos[t == t[rising][-1], 0] == pytest.approx(-a / w**2, rel=1e-3)
        assert np.abs(pos[after]).max() < 0.01 * a / w**2, "it has caught up"


def test_31_the_lag_goes_on_from_piece_to_piece_and_its_acceleration_is_of_the_antenna(turn):
    """A steady turn of rate r: the lag is the acceleration over |w^2 - r^2 + i sqrt(2) w r|."""
    _, pos, vel = lag_of(turn, 3.0, LEVER)
    w = 3.0 / 0.53
    exact = measure(turn, replace(SILENT, rate=20.0), LEVER)
    accel = np.gradient(exact.vel_n, exact.t, axis=0)
    settled = slice(200, -1)
    turned = np.linalg.norm(accel[settled, :2], axis=1) / np.linalg.norm(exact.vel_n[settled, :2], axis=1)
    gain = 1.0 / np.hypot(w**2 - turned**2, np.sqrt(2.0) * w * turned)
    size = np.linalg.norm(pos[settled, :2], axis=1)
    assert_allclose(size, gain * np.linalg.norm(accel[settled, :2], axis=1), rtol=2e-3)
    assert_allclose(np.linalg.norm(vel[settled, :2], axis=1), turned * size, rtol=1e-3)
    _, again, _ = lag_of(turn, 3.0, LEVER, pieces=3)
    assert_array_equal(again, pos)


def test_31_ranges_are_behind_by_the_lag_along_their_line_of_sight():
    """Fixes of a receiver with satellites move as those of a position-level one do; its clock does not."""
    truth = stepping(20.0)
    spec = read_gnss(CATALOG / "sky-l1.toml", "sky-l1")
    plain, behind = (
        sky.measure(
            truth, replace(spec, rate=20.0, tracking_bandwidth=B), (0.0, 0.0, 0.0), (), SensorDraws(1, 0)
        )
        for B in (0.0, 2.0)
    )
    _, pos, vel = lag_of(truth, 2.0)
    a, b = plain.fixes, behind.fixes
    assert_allclose(earth.difference_n(b.lla, a.lla), pos, atol=2e-3)
    assert_allclose(b.vel_n - a.vel_n, vel, atol=2e-3)
