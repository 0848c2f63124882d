"""The measurement-level receiver: exact without errors, each error of its size, satellites lost by geometry.

Statistical bounds are two-sided 99.9 % bands of their statistic at fixed seeds.
"""

from __future__ import annotations

from dataclasses import fields, replace
from pathlib import Path

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

import bench
from bench.core.mathematics import earth, rotation
from bench.core.mathematics.random_streams import stream
from bench.core.records.data import GnssObservations
from bench.core.records.orbit_sets import GLONASS, GPS
from bench.core.records.sky_spec import SkySpec
from bench.core.records.specs import EvaluationWindow
from bench.core.words.exceptions import ConfigError
from bench.io import config
from bench.io.config.datasheets import read_gnss
from bench.simulation.sensors import gnss
from bench.simulation.sensors.draws import SensorDraws
from bench.simulation.sensors.measurement_level import clock, loops, sky, view
from bench.simulation.signals import allan, delays, orbits, receiver_solution
from bench.simulation.signals.allan import fit_flat_deviation
from bench.simulation.signals.processing import Processing
from tests.builders import band
from tests.data import gnss_file
from tests.sensors.given_numbers import respond
from tests.synthetic import ORIGIN, still, turning

CATALOG = Path(bench.__file__).parent / "catalog" / "gnss"
LEVER = (0.4, -0.2, -0.5)
SPEC = read_gnss(CATALOG / "sky-l1.toml", "sky-l1.toml")
FULL = SPEC.sky
OFF = {
    f.name: 0.0
    for f in fields(SkySpec)
    if f.name.endswith("_sd")
    or f.name
    in (
        "ionosphere_share",
        "dll_bandwidth",
        "fll_bandwidth",
        "clock_h_0",
        "clock_h_m1",
        "clock_h_m2",
        "clock_g",
    )
}
QUIET = replace(FULL, **OFF)


@pytest.fixture(scope="module")
def turn():
    return turning(120.0, 20.0)


@pytest.fixture(scope="module")
def rest():
    return still(600.0, 1.0, attitude=(0.0, 0.0, 0.3))


def measure(truth, what, antenna_b=LEVER, outages=(), seed=1, run=0, rate=1.0):
    return sky.measure(truth, replace(SPEC, sky=what, rate=rate), antenna_b, outages, SensorDraws(seed, run))


def simulate_clock(truth, rows, what, run=0):
    steps = np.diff(truth.t[rows], prepend=truth.t[0])
    return clock.simulate_receiver_clock(truth, rows, steps, what, SensorDraws(1, run).part("gnss.sky.clock"))


def exact(truth, fixes, antenna_b=LEVER):
    """Position and velocity error of fixes [m, m/s], n."""
    rows = np.searchsorted(truth.t, fixes.t - 1e-6)
    lla, vel_n = gnss.compute_antenna_motion(truth, rows, antenna_b, SensorDraws(1, 0))
    return earth.difference_n(fixes.lla, lla), fixes.vel_n - vel_n


@pytest.mark.parametrize("bands", [1, 2])
def test_without_errors_a_fix_is_the_antenna(turn, bands):
    """The atmosphere is on, and removed; what remains is 0.1 mm: the satellites are computed at a time that
    is late by the delays, as a receiver does. Clocks of any size do not matter."""
    clocks = {
        "clock_offset_sd": 1e4,
        "clock_drift_sd": 100.0,
        "glonass_offset_sd": 10.0,
        "clock_h_0": 2e-19,
        "clock_h_m1": 7e-21,
        "clock_h_m2": 2e-20,
        "clock_g": 5e-11,
    }
    for what in (QUIET, replace(QUIET, **clocks)):
        found = measure(turn, replace(what, bands=bands))
        pos, vel = exact(turn, found.fixes)
        assert np.abs(pos).max() < 3e-4
        assert np.abs(vel).max() < 3e-7
        assert found.fixes.valid.all()
        assert len(found.fixes) == 120


@pytest.mark.parametrize("hours", [False, True])
def test_the_pseudorange_is_the_sum_of_its_parts(turn, hours):
    """Range by an iteration that turns vectors, delays by their public functions (B-12); after hours, too."""
    truth = still(15000.0, 0.01, attitude=(0.1, 0.2, 0.3)) if hours else turn
    o = measure(truth, QUIET, rate=0.01 if hours else 1.0).observations
    rows = np.searchsorted(truth.t, o.t - 1e-6)
    lla, _ = gnss.compute_antenna_motion(truth, rows, LEVER, SensorDraws(1, 0))
    here = earth.to_ecef(lla)
    sets = [orbits.make_nominal(GPS), orbits.make_nominal(GLONASS)]
    for k in range(0, len(o), 37):
        travel = np.array([0.07])
        for _ in range(5):
            now = o.t[k] + o.gps_t0 - travel
            pos = orbits.compute_states(sets[o.system[k]], np.array([o.sat[k] - 1]), now).pos_e[0]
            c, s = np.cos(orbits.GPS_EARTH_RATE * travel[0]), np.sin(orbits.GPS_EARTH_RATE * travel[0])
            turned = np.array([c * pos[0] + s * pos[1], c * pos[1] - s * pos[0], pos[2]])
            travel = np.array([np.linalg.norm(turned - here[k])]) / orbits.C
        n, e, d = earth.matrix_en(*lla[k, :2]).T @ (turned - here[k])
        el, az = np.arctan2(-d, np.hypot(n, e)), np.arctan2(e, n)
        ionosphere = delays.klobuchar_kernel(
            *lla[k, :2], el, np.sin(az), np.cos(az), o.t[k] + o.gps_t0, o.klobuchar
        )
        ionosphere *= (orbits.L1 / o.frequency[k, 0]) ** 2
        troposphere = delays.zenith_troposphere(lla[k, 0], lla[k, 2]) * delays.mapping_kernel(np.sin(el))
        expected = orbits.C * travel[0] + ionosphere + troposphere
        assert abs(o.pseudorange[k, 0] - expected) < 1e-6
        late = o.t[k] + o.gps_t0 - o.pseudorange[k] / orbits.C  # by the delays, as the receiver takes it
        then = orbits.compute_states(sets[o.system[k]], np.array([o.sat[k] - 1]), late).pos_e[0]
        assert_allclose(o.sat_pos_e[k], then, rtol=0, atol=1e-5)
        assert abs(o.cn0[k, 0] - by_antenna(truth, rows[k], [n, e, d])) < 1e-6


def by_antenna(truth, row, toward_n):
    up_n = rotation.rotate(truth.q_nb[row], [0.0, 0.0, -1.0])
    sine = np.dot(up_n, toward_n) / np.linalg.norm(toward_n)
    return FULL.cn0_horizon + (FULL.cn0_zenith - FULL.cn0_horizon) * sine


def test_two_carriers_see_the_ionosphere(turn):
    """Their difference is the ionosphere's, (f1/f2)^2 - 1 of it; combined it is gone below 1e-6 m (B-11)."""
    o = measure(turn, replace(QUIET, bands=2, second_band_loss=0.0)).observations
    no = measure(turn, replace(QUIET, bands=2, klobuchar=(0.0,) * 8)).observations
    free = Processing(ionosphere="free")
    assert np.abs(o.pseudorange - no.pseudorange).min() > 0.01
    assert (
        np.abs(
            receiver_solution.correct_pseudoranges(o, free) - receiver_solution.correct_pseudoranges(no, free)
        ).max()
        < 1e-6
    )


def test_what_is_above_the_mask_is_what_the_orbits_say():
    """Every satellite each 100 s of four hours, with the Earth turned by 0.075 s; none is below the mask."""
    truth, mask = still(15000.0, 0.01), np.deg2rad(15.0)
    seen = measure(truth, replace(QUIET, elevation_mask=mask), (0.0, 0.0, 0.0), rate=0.01).above
    assert seen.elevation.min() >= mask
    C_en = earth.matrix_en(*ORIGIN[:2])
    t, here, up_e = truth.t[1:], earth.to_ecef(ORIGIN), -C_en[:, 2]
    sets = {system: orbits.make_nominal(system) for system in (GPS, GLONASS)}
    for system, k in ((system, k) for system, one in sets.items() for k in range(len(one))):
        then = t + QUIET.gps_t0 - 0.075
        away = orbits.compute_states(sets[system], np.full(len(t), k), then).pos_e - here
        turned = away + np.cross([0.0, 0.0, -orbits.GPS_EARTH_RATE * 0.075], away + here)
        elevation = np.arcsin(turned @ up_e / np.linalg.norm(turned, axis=1))
        sure = np.abs(elevation - mask) > 2e-6
        rows = (seen.system == system) & (seen.sat == k + 1)
        found = np.isin(t, seen.t[rows])
        assert_array_equal(found[sure], (elevation > mask)[sure])
        north, east = (turned[found] @ C_en[:, :2]).T
        off = np.exp(1j * (seen.azimuth[rows] - np.arctan2(east, north))) - 1.0
        assert_allclose(np.abs(off), 0.0, atol=1e-4)
        assert_allclose(seen.elevation[rows], elevation[found], rtol=0, atol=1e-5)


def test_a_bank_loses_the_satellites_geometry_says():
    """Level and banked 45 deg: exactly those below the antenna's mask in body axes."""
    level = still(20.0, 1.0, attitude=(0.0, 0.0, 0.0))
    banked = still(
        20.0, 1.0, attitude=(np.deg2rad(45.0), 0.0, 0.0)
    )  # right wing down: the antenna looks right
    what = replace(QUIET, antenna_mask=0.0, reacquisition=0.0, cn0_threshold=0.0)
    kept, lost = [], []
    seen, left = (measure(truth, what).observations for truth in (level, banked))
    final = seen.t == seen.t[-1]
    here = earth.to_ecef(gnss.compute_antenna_motion(level, np.array([20]), LEVER, SensorDraws(1, 0))[0][0])
    for system, sat, pos in zip(seen.system[final], seen.sat[final], seen.sat_pos_e[final], strict=True):
        _, e, d = earth.matrix_en(*ORIGIN[:2]).T @ (pos - here)
        above = e * np.sin(np.deg2rad(45.0)) - d * np.cos(np.deg2rad(45.0))  # along the antenna's axis
        still_there = ((left.system == system) & (left.sat == sat) & (left.t == left.t[-1])).any()
        assert still_there == (above > 0)
        (kept if still_there else lost).append(e)
    assert len(lost) >= 3
    assert max(lost) < 0 < max(kept)  # what is lost is west, below the raised left wing


def test_a_lost_satellite_comes_back_after_reacquisition():
    """Rolling to 60 deg and back at a known time: epochs without it last the roll and the wait."""
    truth = still(60.0, 1.0, attitude=(0.0, 0.0, 0.0))
    q_nb = np.array(truth.q_nb)
    q_nb[20:31] = rotation.from_euler(np.deg2rad(60.0), 0.0, 0.0)
    rolled = replace(truth, q_nb=q_nb)
    counts = {}
    for wait in (0.0, 4.0):
        o = measure(rolled, replace(QUIET, antenna_mask=0.0, reacquisition=wait)).observations
        assert_array_equal(o.epoch_start[-1], len(o))
        counts[wait] = np.diff(o.epoch_start)
    assert counts[0.0][18] == counts[0.0][30] > counts[0.0][24]
    assert (counts[4.0][30:34] == counts[0.0][24]).all()
    assert counts[4.0][34] == counts[0.0][30]
    assert (counts[4.0][:19] == counts[0.0][:19]).all()


def test_a_weak_signal_is_not_tracked(rest):
    o = measure(rest, replace(QUIET, cn0_threshold=45.0)).observations
    assert o.cn0.min() >= 45.0
    assert len(o) < len(measure(rest, QUIET).observations)


def test_outages_leave_out_their_epochs_and_change_no_other(turn):
    whole, broken = measure(turn, FULL), measure(turn, FULL, outages=((20.0, 30.0),))
    keep = (whole.fixes.t < 19.99) | (whole.fixes.t > 29.99)
    assert_array_equal(broken.fixes.t, whole.fixes.t[keep])
    assert_array_equal(broken.fixes.lla, whole.fixes.lla[keep])
    rows = (whole.observations.t < 19.99) | (whole.observations.t > 29.99)
    assert_array_equal(broken.observations.pseudorange, whole.observations.pseudorange[rows])


TERMS = {
    "code.1": {"dll_bandwidth": 0.5},
    "multipath.1": {"multipath_zenith_sd": 0.13, "multipath_horizon_sd": 0.53},
    "space": {"gps_space_sd": 0.6, "glonass_space_sd": 2.0},
    "ionosphere": {"ionosphere_sd": 2.0, "ionosphere_share": 0.0},
    "troposphere": {"troposphere_sd": 0.12},
}


SHARED = ("ionosphere", "troposphere")  # by the satellites of an epoch


def claimed(o, term, chip=(293.0522561, 586.6779022)):
    """Standard deviation of each row's error, from its elevation and C/N0, by the sources' formulas."""
    C_en = earth.matrix_en(*ORIGIN[:2])
    away = o.sat_pos_e - earth.to_ecef(ORIGIN)
    sine = -(away @ C_en)[:, 2] / np.linalg.norm(away, axis=1)
    el = np.arcsin(sine)
    if term == "code.1":
        ratio = 10 ** (o.cn0[:, 0] / 10)
        loss = 1 + 2 / ((2 - FULL.dll_spacing) * FULL.integration * ratio)
        return np.array(chip)[o.system] * np.sqrt(0.5 * FULL.dll_spacing / (2 * ratio) * loss)
    if term == "multipath.1":
        return 0.13 + 0.53 * np.exp(-np.rad2deg(el) / 10)
    if term == "space":
        return np.array([0.6, 2.0])[o.system]
    if term == "ionosphere":
        return 2.0 * (1 + 16 * (0.53 - el / np.pi) ** 3) * (orbits.L1 / o.frequency[:, 0]) ** 2
    return 0.12 * 1.001 / np.sqrt(0.002001 + sine**2)


@pytest.mark.parametrize("term", TERMS)
def test_each_range_error_has_its_size(rest, term):
    """#32: RMS of error over its formula within 5 %, over 200 runs; rows of one satellite and run are
    one sample (the slow ones stay put), those that are shared one per run."""
    short = still(2.0, 1.0, attitude=(0.0, 0.0, 0.3))
    clean = measure(short, QUIET, (0.0, 0.0, 0.0)).observations
    what, ratios = replace(QUIET, **TERMS[term]), []
    sd = claimed(clean, term)
    for run in range(200):
        o = measure(short, what, (0.0, 0.0, 0.0), run=run).observations
        error = o.pseudorange[:, 0] - clean.pseudorange[:, 0]
        first = slice(0, o.epoch_start[1]) if term not in SHARED else slice(0, 1)
        ratios.append((error / sd)[first])
    ratios = np.concatenate(ratios)
    low, high = band(len(ratios))
    assert low < np.mean(ratios**2) < high
    if term not in SHARED:
        assert 0.95**2 < low < high < 1.05**2
    assert not low < 1.3**2 < high


def test_the_assumed_size_of_an_error_is_the_root_of_the_sum_of_its_parts():
    """Of a range those of the sources; without any error a centimeter, and 0.1 mm/s of a range rate."""
    short = still(2.0, 1.0, attitude=(0.0, 0.0, 0.3))
    figures = {name: value for term in TERMS.values() for name, value in term.items()}
    o = measure(short, replace(QUIET, **figures), (0.0, 0.0, 0.0)).observations
    total = np.sqrt(sum(claimed(o, term) ** 2 for term in TERMS))
    assert_allclose(o.sd_pseudorange, total, rtol=1e-4)
    for term in TERMS:
        assert np.abs(np.sqrt(total**2 - claimed(o, term) ** 2) / total - 1).max() > 1e-3
    exact = measure(short, QUIET).observations
    assert (exact.sd_pseudorange == 0.01).all()
    assert (exact.sd_range_rate == 1e-4).all()
    both = replace(QUIET, bands=2, dll_bandwidth=0.5, fll_bandwidth=2.0)
    noisy = measure(short, both).observations
    of_rate = loops.doppler_sd(noisy.cn0[:, 0], noisy.frequency[:, 0], both)  # on the first carrier
    assert_allclose(noisy.sd_range_rate, of_rate, rtol=1e-12)
    assert sky.make_processing(replace(FULL, second_band_loss=40.0)).budget.second_band == pytest.approx(100)


def test_doppler_noise_has_its_size(rest):
    clean, noisy = (
        measure(rest, QUIET).observations,
        measure(rest, replace(QUIET, fll_bandwidth=2.0)).observations,
    )
    ratio = 10 ** (clean.cn0[:, 0] / 10)
    T = FULL.integration
    sd = orbits.C / clean.frequency[:, 0] / (2 * np.pi * T) * np.sqrt(8 / ratio * (1 + 1 / (T * ratio)))
    low, high = band(len(sd))
    assert low < np.mean(((noisy.range_rate - clean.range_rate)[:, 0] / sd) ** 2) < high
    assert_array_equal(noisy.pseudorange, clean.pseudorange)


def test_the_noise_of_the_loops_is_that_of_the_chip_and_carrier_of_each_system():
    """Kaplan and Hegarty, eq. 5.23 and 5.9; the correlation of Galileo's BOC(1,1) is three times as steep."""
    system, cn0, frequency = np.arange(4).repeat(2), np.tile([35.0, 50.0], 4), np.linspace(1.2e9, 1.6e9, 8)
    chip = np.array([293.052256, 586.678, 293.052256 / np.sqrt(3), 146.526128])[system]
    n, d, T = 10 ** (cn0 / 10), FULL.dll_spacing, FULL.integration
    code = chip * np.sqrt(FULL.dll_bandwidth * d / (2 * n) * (1 + 2 / ((2 - d) * T * n)))
    doppler = orbits.C / frequency / (2 * np.pi * T) * np.sqrt(4 * FULL.fll_bandwidth / n * (1 + 1 / (T * n)))
    assert_allclose(loops.find_loop_noise(system, cn0, frequency, FULL), [code, doppler], rtol=1e-6)


def test_the_second_band_is_weaker_and_has_noise_of_its_own(rest):
    noise = {"dll_bandwidth": 0.5, "fll_bandwidth": 2.0}
    two = replace(QUIET, bands=2, second_band_loss=4.0)
    clean, noisy = (measure(rest, one).observations for one in (two, replace(two, **noise)))
    assert_allclose(clean.cn0[:, 0] - clean.cn0[:, 1], 4.0)
    low, high = band(len(clean))
    for kind, name in enumerate(("pseudorange", "range_rate")):
        added = getattr(noisy, name) - getattr(clean, name)
        for k in range(2):
            given = clean.system, clean.cn0[:, k], clean.frequency[:, k], replace(two, **noise)
            assert low < np.mean((added[:, k] / loops.find_loop_noise(*given)[kind]) ** 2) < high
        assert abs(np.corrcoef(added.T)[0, 1]) < 3.29 / np.sqrt(len(clean))


def test_slow_errors_remember(rest):
    """Correlation at one correlation time is 1/e: of the multipath, 80 s, over 13 satellites and 5 runs.

    About 20 independent segments of 600 s each hold 7 correlation times: 0.37 +- 0.25. White noise has 0.
    """
    what, products, squares = replace(QUIET, **TERMS["multipath.1"]), [], []
    clean = measure(rest, QUIET).observations
    sd = claimed(clean, "multipath.1")
    for run in range(5):
        error = (measure(rest, what, run=run).observations.pseudorange - clean.pseudorange)[:, 0] / sd
        for key in {(s, n) for s, n in zip(clean.system, clean.sat, strict=True)}:
            mine = error[(clean.system == key[0]) & (clean.sat == key[1])]
            if len(mine) == 600:
                products.append(np.mean(mine[80:] * mine[:-80]))
                squares.append(np.mean(mine**2))
    assert len(squares) >= 40
    assert abs(np.mean(products) / np.mean(squares) - np.exp(-1)) < 0.25
    assert np.mean(products) / np.mean(squares) > 0.1


def test_the_clock_has_the_allan_deviation_of_its_coefficients():
    """White frequency noise: sigma_y^2 = h0 / (2 tau); random walk: (2 pi^2 / 3) h-2 tau (IEEE Std 1139)."""
    truth = still(20000.0, 1.0, attitude=(0.0, 0.0, 0.0))
    rows = np.arange(1, 20001)
    for h_0, h_m2, tau in ((2e-19, 0.0, 1), (2e-19, 0.0, 16), (0.0, 2e-20, 4), (0.0, 2e-20, 16)):
        what = replace(QUIET, clock_h_0=h_0, clock_h_m2=h_m2)
        offset, _ = simulate_clock(truth, rows, what)
        x = offset / orbits.C
        second = x[2 * tau :: tau] - 2 * x[tau:-tau:tau] + x[: -2 * tau : tau]
        variance = np.mean(second**2) / (2 * tau**2)
        expected = h_0 / (2 * tau) + 2 * np.pi**2 / 3 * h_m2 * tau
        spread = 3.29 * np.sqrt(3.0 / len(second))  # neighbors of second differences are correlated
        assert abs(variance / expected - 1) < spread
    one, two = (simulate_clock(truth, rows, replace(QUIET, clock_h_0=h))[0] for h in (2e-19, 8e-20))
    assert_allclose(two, one * np.sqrt(0.4), rtol=1e-9)  # an OCXO is quieter


def test_the_flicker_of_the_clock_is_flat_at_its_floor():
    """sigma_y^2 = 2 ln 2 h-1 whatever tau (IEEE Std 1139): octaves to 1024 s, 24 runs of 20000 s.

    Each mean lies within the 99.9 % band of the spread of its runs (Student t), widened by 2 % for the stages
    themselves; white noise of the same level at 1 s would be 30 times less at 1024 s.
    """
    from scipy.special import stdtrit

    h_m1, truth, rows = 7e-21, still(20000.0, 1.0, attitude=(0.0, 0.0, 0.0)), np.arange(1, 20001)
    what = replace(QUIET, clock_h_m1=h_m1)
    runs = [simulate_clock(truth, rows, what, run) for run in range(24)]
    taus = np.geomspace(0.1, 1e4, 41)
    stages = zip(fit_flat_deviation(clock.STAGES, *clock.FLAT_TIMES), clock.STAGES, strict=True)
    flat = np.sqrt(sum(allan.gauss_markov_deviation(taus, sd, c) ** 2 for sd, c in stages))
    assert np.abs(flat - 1).max() < 0.016
    for tau in 2 ** np.arange(11):
        variances = []
        for offset, _ in runs:
            x = offset / orbits.C
            second = x[2 * tau :] - 2 * x[tau:-tau] + x[: -2 * tau]
            variances.append(np.mean(second**2) / (2 * tau**2))
        ratio = np.array(variances) / (2 * np.log(2) * h_m1)
        spread = stdtrit(23, 0.9995) * ratio.std(ddof=1) / np.sqrt(24)
        assert abs(ratio.mean() - 1) < spread + 0.04, tau
        assert spread < 0.4
    offset, drift = runs[0]
    middle = 0.5 * (drift[1:] + drift[:-1])  # the offset is the integral of the drift
    steps = np.diff(offset)
    assert np.corrcoef(steps, middle)[0, 1] > 0.9


def test_the_flicker_does_not_depend_on_the_step():
    """Ten steps of 0.1 s are one of 1 s: the same Allan deviation at 1 s, within its 99.9 % band."""
    h_m1 = 7e-21
    for rate, count in ((1.0, 20000), (10.0, 200000)):
        truth = still(20000.0, rate, attitude=(0.0, 0.0, 0.0))
        offset, _ = simulate_clock(truth, np.arange(1, count + 1), replace(QUIET, clock_h_m1=h_m1))
        x = offset[:: int(rate)] / orbits.C
        variance = np.mean(np.diff(x, n=2) ** 2) / 2
        assert abs(variance / (2 * np.log(2) * h_m1) - 1) < 3.29 * np.sqrt(3.0 / len(x)) + 0.04


def test_offset_and_drift_of_the_clock_have_the_covariance_of_their_densities():
    """Brown and Hwang, 10.3: exact at unequal epochs, of white noise and random walk of frequency at once."""
    truth, rows = still(8.0, 1.0), np.array([1, 2, 4, 7])
    steps, noisy = np.diff(rows, prepend=0).astype(float), replace(QUIET, clock_h_0=4e-19, clock_h_m2=2e-20)
    response = respond(
        "noise", 6, lambda draws: np.array(clock.simulate_receiver_clock(truth, rows, steps, noisy, draws))
    )
    since = rows - 1.0  # from the first epoch
    a, b = np.meshgrid(since, since, indexing="ij")
    early, late = np.minimum(a, b), np.maximum(a, b)
    white, walk = 0.5 * orbits.C**2 * 4e-19, 2 * np.pi**2 * orbits.C**2 * 2e-20
    offsets = white * early + walk * early**2 * (late / 2 - early / 6)
    both = walk * np.where(b >= a, a**2 / 2, a * b - b**2 / 2)  # of the offset at a and the drift at b
    expected = np.block([[offsets, both], [both.T, walk * early]])
    assert_allclose(response @ response.T, expected, rtol=1e-12, atol=1e-18)
    assert (response >= 0).all()


def test_a_stage_of_flicker_and_its_integral_have_the_covariance_of_a_stationary_process():
    """By integrals of exp(-|lag| / T), given the stage at the start; steps from 1e-3 to 20 times T."""
    T, sd, dt = np.array([1.0, 7.0]), np.array([1.0, 3.0]), np.array([0.0, 9e-4, 2e-3, 0.5, 20.0])
    columns = []
    for number in np.eye(20):
        out = np.zeros((5, 2))
        clock.flicker_kernel(dt, T, sd, number.reshape(5, 2, 2), False, np.zeros((2, 2)), out)
        columns.append(out.T.ravel())
    response = np.array(columns).T
    t = np.cumsum(dt).astype(np.longdouble)
    a, b = np.meshgrid(t, t, indexing="ij")
    early, late, total = np.minimum(a, b), np.maximum(a, b), 0.0
    for one, size in zip(T, sd, strict=True):

        def fade(lag, one=one):
            return np.exp(-lag / one)

        sums = 2 * early * one + one**2 * (fade(a) + fade(b) - fade(late - early) - 1)
        both = one * np.where(b >= a, fade(b - a) - fade(b), 2 - fade(b) - fade(a - b))
        first = np.concatenate([one * (1 - fade(t)), fade(t)])  # with the stage at the start
        known = np.block([[sums, both], [both.T, fade(late - early)]])
        total = total + size**2 * (known - np.outer(first, first))
    later = response[:, 4:]
    assert_allclose(later @ later.T, total.astype(float), rtol=1e-5, atol=1e-16)
    start = [*(3.0 * 7.0 * -np.expm1(-np.cumsum(dt) / 7.0)), *(3.0 * np.exp(-np.cumsum(dt) / 7.0))]
    assert_allclose(response[:, 2], start, rtol=1e-12)  # of the second stage alone
    assert not response[:, [1, 3]].any()
    assert (response >= 0).all()


def test_a_slow_error_is_a_line_between_gauss_markov_values():
    """At 1 Hz and a correlation time of 80 s one value every 2 s, of each satellite alone."""
    epochs, which = np.arange(9).repeat(2), np.tile([0, 1], 9)

    def drawn(draws):
        return sky.SkyErrors(np.arange(9.0), epochs, which, 2, 1.0, draws).draw_markov("slow", 80.0)

    response = respond("gnss.sky.slow", 12, drawn).reshape(9, 2, 12)
    at = response[::2]
    covariance = np.einsum("ikn,jln->ijkl", at, at)
    lag = 2.0 * np.abs(np.subtract.outer(np.arange(5), np.arange(5)))
    assert_allclose(covariance, np.exp(-lag / 80.0)[:, :, None, None] * np.eye(2), atol=1e-14)
    assert_allclose(response[1::2], 0.5 * (at[:-1] + at[1:]), atol=1e-15)
    assert (response >= 0).all()


def test_orbits_are_fitted_again_where_a_flight_goes_beyond_them(monkeypatch):
    """Both fits have the bits of each other where both hold, and reach to the end of the piece."""
    monkeypatch.setattr(view, "AHEAD", 1000.0)
    draws, state, found = SensorDraws(1, 0), np.empty((2, 8)), []
    for t in (np.array([20.0, 30.0]), np.array([30.0, 1010.0]), np.array([1010.0, 2990.0])):
        *_, track = view.find_track(QUIET, t, draws)
        found.append(track)
        exact = orbits.compute_states(orbits.make_nominal(GPS), np.array([3]), t[-1:] + QUIET.gps_t0)
        orbits.track_kernel(*track, 3, t[-1] + QUIET.gps_t0, True, state[0])
        assert_allclose(state[0, :3], exact.pos_e[0], rtol=0, atol=1e-4)
        assert_allclose(state[0, 4:7], exact.vel_e[0], rtol=0, atol=1e-6)
        assert track.t_0 < t[0] + QUIET.gps_t0
    assert found[0] is found[1]
    for track, row in zip(found[1:], state, strict=True):
        orbits.track_kernel(*track, 30, 25.0 + QUIET.gps_t0, True, row)
    assert_array_equal(state[0], state[1])


def test_antipodal_glonass_satellites_share_a_channel():
    """Nominal orbits: the channels of the ICD, four to a plane of eight."""
    number = np.arange(1, 25)
    found = view.find_channels(orbits.make_nominal(GLONASS), number)
    assert_array_equal(found, [*[-7, -6, -5, -4] * 2, *[-3, -2, -1, 0] * 2, *[1, 2, 3, 4] * 2])


def test_specific_force_bends_the_clock(turn):
    """0.5 ppb/g in a turn of 1.26 g along down: drift c y, and the offset is its integral."""
    what = replace(QUIET, clock_g=0.5e-9 / 9.80665)
    rows = np.arange(0, 2401, 20)[1:]
    offset, drift = simulate_clock(turn, rows, what)
    f_down = turn.dvel_b[0, 2] * 20.0
    assert f_down < -9.9
    assert_allclose(drift, orbits.C * what.clock_g * f_down, rtol=1e-9)
    assert_allclose(offset, drift * turn.t[rows], rtol=1e-9)


@pytest.mark.parametrize(
    ("figure", "name", "systems"),
    [
        ("clock_offset_sd", "clock.offset", (GPS, GLONASS)),
        ("clock_drift_sd", "clock.drift", (GPS, GLONASS)),
        ("glonass_offset_sd", "glonass_offset", (GLONASS,)),
    ],
)
def test_constant_offsets_are_the_figure_times_what_was_drawn(turn, figure, name, systems):
    """In the ranges of its systems alone; a drift from the first epoch on, and in the range rates."""
    clean, moved = (
        measure(turn, QUIET).observations,
        measure(turn, replace(QUIET, **{figure: 5.0})).observations,
    )
    size = 5.0 * stream(1, 0, f"gnss.sky.{name}").standard_normal() * np.isin(clean.system, systems)
    drift = figure == "clock_drift_sd"
    expected = size * (clean.t - clean.t[0] if drift else 1.0)
    assert_allclose((moved.pseudorange - clean.pseudorange)[:, 0], expected, rtol=0, atol=1e-7)
    assert_allclose((moved.range_rate - clean.range_rate)[:, 0], size * drift, rtol=0, atol=1e-9)


def test_every_error_has_its_stream_and_none_is_drawn_for_nothing(turn, streams_drawn):
    drawn = streams_drawn()
    measure(turn, QUIET)
    assert drawn == []
    measure(turn, replace(FULL, bands=2, clock_h_m1=7e-21))
    names = [
        "clock.offset",
        "clock.drift",
        "clock.noise",
        "clock.flicker",
        "glonass_offset",
        "space",
        "ionosphere",
        "ionosphere.waves",
        "troposphere",
    ]
    names += [f"{term}.{band}" for term in ("code", "doppler", "multipath") for band in (1, 2)]
    assert sorted(drawn) == sorted(f"gnss.sky.{name}" for name in names)


@pytest.mark.parametrize("term", TERMS)
def test_one_error_more_leaves_the_others_their_bits(turn, term):
    """What an error adds is the same alone, beside all others, and with another mask, up to rounding."""
    alone = replace(QUIET, **TERMS[term])
    full = replace(FULL, **TERMS[term])
    without = replace(full, **dict.fromkeys(TERMS[term], 0.0))
    added = [
        (measure(turn, a).observations.pseudorange - measure(turn, b).observations.pseudorange)
        for a, b in ((alone, QUIET), (full, without))
    ]
    assert np.abs(added[0]).max() > 0.01
    assert_allclose(added[0], added[1], rtol=0, atol=3e-8)
    wide, narrow = (
        measure(turn, replace(alone, elevation_mask=np.deg2rad(m))).observations for m in (5.0, 20.0)
    )
    where = {
        (t, s, n): p for t, s, n, p in zip(wide.t, wide.system, wide.sat, wide.pseudorange[:, 0], strict=True)
    }
    same = [where[key] for key in zip(narrow.t, narrow.system, narrow.sat, strict=True)]
    assert_array_equal(narrow.pseudorange[:, 0], same)


def test_full_errors_match_what_the_receiver_claims(rest):
    """Normalized squared position error over 300 runs at one time, three degrees of freedom each.

    Sds reported 1.5 times too small would be seen.
    """
    short = still(5.0, 1.0, attitude=(0.0, 0.0, 0.3))
    squares = []
    for run in range(300):
        fixes = measure(short, FULL, run=run).fixes
        error = exact(short, fixes)[0][-1]
        squares.append(error @ np.linalg.solve(fixes.cov_pos_n[-1], error))
    low, high = band(3 * len(squares))
    assert low < np.mean(squares) / 3 < high
    assert not low < 1.5**2 < high


def test_the_prediction_does_not_change_the_fix(turn):
    """From the sensor's own prediction or from the center of the Earth: within 2 cm, as the delays are
    those of the prediction or of the receiver's own height, meters away."""
    found = measure(turn, FULL)
    again = receiver_solution.solve_fixes(found.observations, sky.make_processing(FULL))
    assert np.abs(earth.difference_n(again.fixes.lla, found.fixes.lla)).max() < 0.02
    assert_array_equal(again.used, found.solution.used)


def test_systems_and_the_best_set(turn):
    both = measure(turn, FULL).fixes.satellites
    gps, glonass = (measure(turn, replace(FULL, systems=s)) for s in ("gps", "glonass"))
    assert_array_equal(gps.fixes.satellites + glonass.fixes.satellites >= both, True)
    assert not gps.solution.used[gps.observations.system == 1].any()
    auto = measure(turn, replace(FULL, systems="auto", glonass_space_sd=30.0))
    assert not auto.solution.used[auto.observations.system == 1].any()
    assert len(measure(turn, FULL, rate=10.0).fixes) == 1200


def test_latency_and_a_receiver_without_sky(turn):
    late = sky.measure(turn, replace(SPEC, latency=0.2), LEVER, (), SensorDraws(1, 0))
    assert_allclose(late.fixes.t_arrival - late.fixes.t, 0.2)
    assert_allclose(late.observations.t_arrival - late.observations.t, 0.2)
    with pytest.raises(ValueError, match="'x' is a position-level receiver"):
        sky.measure(turn, replace(SPEC, name="x", sky=None), LEVER, (), SensorDraws(1, 0))


def test_real_satellites_fly_too(turn, tmp_path):
    """With the almanac of 2022-02-17 PRN 11 is unhealthy and not seen; broadcast files serve both."""
    text = (CATALOG / "sky-l1.toml").read_text(encoding="utf-8")
    for name in ("yuma_2022-02-17.txt", "brdc3050.12n", "brdc3050.12g"):
        (tmp_path / name).write_bytes(gnss_file(name).read_bytes())
    sheets = {
        "yuma": text.replace("[sky]\n", '[sky]\nalmanac = "yuma_2022-02-17.txt"\n'),
        "brdc": text.replace("[sky]\n", '[sky]\nnavigation = ["brdc3050.12n", "brdc3050.12g"]\n').replace(
            "2022-02-17T12", "2012-10-31T12"
        ),
    }
    for name, sheet in sheets.items():
        (tmp_path / f"{name}.toml").write_text(sheet, encoding="utf-8")
        spec = read_gnss(tmp_path / f"{name}.toml", f"{name}.toml")
        found = sky.measure(turn, replace(spec, sky=replace(spec.sky, **OFF)), LEVER, (), SensorDraws(1, 0))
        pos, vel = exact(turn, found.fixes)
        assert np.abs(pos).max() < 3e-4
        assert np.abs(vel).max() < 1e-6
        assert (found.fixes.satellites >= 10).all()
        assert name != "yuma" or 11 not in found.observations.sat[found.observations.system == 0]
    late = sheets["brdc"].replace("2012-10-31T12", "2012-11-20T12")
    (tmp_path / "late.toml").write_text(late, encoding="utf-8")
    with pytest.raises(ConfigError, match=r"has no GPS ephemeris near start = 2012-11-20 12:00:00"):
        read_gnss(tmp_path / "late.toml", "late.toml")


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ("ionosphere_correlation_s = 1800.0\n", "", "[sky] ionosphere_sd_m needs ionosphere_correlation_s"),
        ("bands = 1\n", "bands = 3\n", "[sky] bands = 3 must be 1 or 2"),
        (
            "elevation_mask_deg = 5.0\n",
            "elevation_mask_deg = 1.0\n",
            "[sky] elevation_mask_deg = 1 deg is outside 3 to 60 deg",
        ),
        (
            "cn0_zenith_dbhz = 50.0\n",
            "cn0_zenith_dbhz = 500.0\n",
            "cn0_zenith_dbhz = 500 dB-Hz is outside 0 to 70 dB-Hz",
        ),
        ("start = 2022-02-17T12:00:00 ", "start = 2022-02-17T12:00:00Z ", "must have no time zone"),
        ('systems = "both"\n', 'systems = "both"\nsatelites = 3\n', "[sky]: unknown key 'satelites'"),
        ('systems = "both"\n', 'almanac = "none.txt"\n', "none.txt: no such file"),
        (
            'systems = "both"\n',
            'almanac = "a"\nnavigation = ["b"]\n',
            "give either almanac or navigation, not both",
        ),
    ],
)
def test_a_wrong_sky_gets_one_line(tmp_path, old, new, said):
    text = (CATALOG / "sky-l1.toml").read_text(encoding="utf-8")
    assert old in text
    path = tmp_path / "mine.toml"
    path.write_text(text.replace(old, new), encoding="utf-8")
    with pytest.raises(ConfigError) as caught:
        read_gnss(path, "mine.toml")
    assert said in str(caught.value)
    assert all(line.startswith("mine.toml") for line in str(caught.value).splitlines() if "known" not in line)


def test_a_profile_flies_with_it(short_truth, tmp_path):
    """The loose filter takes its fixes as those of the position level; observations reach the disk."""
    from bench import pipeline
    from bench.io import results
    from bench.navigation.models.loose_tight import Loose
    from bench.simulation.sensors import sense

    profile = config.read_profile("figure-eight", {"sensors.gnss": "sky-l1"})
    sensed = sense(short_truth, replace(profile.sensors, gnss_outages=()), 1, 0)
    assert sensed.data.observations is not None
    solution = Loose().run(sensed.data, sensed.initial)
    errors, _ = pipeline.measure(replace(profile, evaluation=EvaluationWindow(20.0)), short_truth, solution)
    assert np.abs(errors.pos_n[-1]).max() < 15
    facts = results.result_folder.describe_record(sensed.data.observations, sensed.data)
    path = tmp_path / results.result_folder.OBSERVATIONS
    results.result_folder.parquet.write(path, sensed.data.observations, **facts)
    back = results.load_observations(tmp_path)
    for name in GnssObservations.__slots__:
        assert_array_equal(getattr(back, name), getattr(sensed.data.observations, name), err_msg=name)
    assert results.load_observations(tmp_path / "none") is None
