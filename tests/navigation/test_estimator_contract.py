"""What every filter owes the bench, built in or the user's, and that the check sees each way to break it.

It pickles, is repeatable, leaves its input alone, answers at every output time, says how sure it is, and
never meets the truth. An option has its effect, a wrong one its message; a filter that diverges is a result.
"""

from __future__ import annotations

import pickle
import subprocess
import sys
from dataclasses import fields, replace
from importlib.util import find_spec

import numpy as np
import pytest
from numpy.testing import assert_array_equal

import bench
from bench.core.records.data import NavSolution
from bench.core.records.specs import EvaluationWindow
from bench.core.words.exceptions import EstimatorError
from bench.evaluation.metrics import run_metrics
from bench.navigation.built_in import BUILT_IN, load
from bench.navigation.estimator import check_needs
from bench.navigation.models.loose_tight import Loose
from bench.simulation import sensors
from tests.builders import assert_same_solution
from tests.weaving import BARO, GNSS, IMU, units, weaving

COLUMNS = ("t", "lla", "vel_n", "q_nb", "gyro_bias_b", "accel_bias_b", "cov", "extra", "extra_sd")

FLIGHT, UNITS = (30.0,), units()

STANDING = '''
import numpy as np
from bench.core.records.data import NavSolution

class Standing:
    """Stays where it starts, ever less sure."""

    def __init__(self, *, drift: float = 30.0):
        self.drift = drift

    def run(self, sensors, initial):
        t, (a, b, c) = sensors.output_t, (initial.lla, initial.vel_n, initial.q_nb)
        one, none = np.ones((len(t), 1)), np.full((len(t), 3), np.nan)
        cov = initial.cov + (self.drift * (t - initial.t))[:, None, None] ** 2 * np.eye(9)
        extra = np.empty((len(t), 0))
        return NavSolution(t, one * a, one * b, one * c, none, none, cov, (), extra, extra)
'''


# --- what every filter owes --------------------------------------------------------------------------


@pytest.mark.parametrize("name", BUILT_IN)
def test_every_built_in_estimator_keeps_the_contract(sensed, name):
    bench.check_estimator(load(name, {}), shorten(sensed.data, name), sensed.initial)


@pytest.mark.parametrize("name", BUILT_IN)
def test_they_keep_it_without_aiding(sensed, name):
    data = replace(shorten(sensed.data, name), fixes=None, baro=None)
    bench.check_estimator(load(name, {}), data, sensed.initial)


def shorten(data, name):
    """The first five seconds of a record for the filters in plain Python; all of it for the others."""
    if BUILT_IN[name].import_class().__module__.split(".")[-1] in ("loose_tight", "smoother", "gnss_only"):
        return data
    cut = {
        record: type(one)(**{f.name: getattr(one, f.name)[one.t <= 5.0] for f in fields(one)})
        for record in ("imu", "fixes", "baro")
        if (one := getattr(data, record)) is not None
    }
    return replace(data, **cut, output_t=data.output_t[data.output_t <= 5.0])


@pytest.mark.parametrize("name", BUILT_IN)
def test_they_refuse_only_what_has_no_datasheet(sensed, name):
    """A record of a sensor without an assumed unit cannot be weighed; the message says which."""
    data = replace(sensed.data, specs=replace(sensed.data.specs, gnss=None, baro=None))
    if name in ("free-inertial", "ahrs"):
        bench.check_estimator(load(name, {}), data, sensed.initial)
        return
    if name not in ("gnss-only", "invariant-ekf", "graph-smoother"):  # no barometer
        with pytest.raises(ValueError, match=r"baro data, but sensors\.assumed names no baro unit"):
            load(name, {}).run(data, sensed.initial)
    if name in ("baro-inertial", "tight"):  # neither looks at fixes
        return
    with pytest.raises(ValueError, match=r"gnss data, but sensors\.assumed names no gnss unit"):
        load(name, {}).run(replace(data, baro=None), sensed.initial)


@pytest.mark.parametrize("name", BUILT_IN)
def test_what_they_need_is_said_before_the_flight(name):
    """With all sensors none complains; without GNSS only those of IMU and barometer are content."""
    built = load(name, {})
    check_needs(built, name, {"fixes", "observations", "baro"})
    if name in ("free-inertial", "baro-inertial", "ahrs"):
        check_needs(built, name, {"baro"})
    else:
        with pytest.raises(EstimatorError, match=rf"filter '{name}' needs a gnss.*; there is none"):
            check_needs(built, name, {"baro"})
    if name == "baro-inertial":
        with pytest.raises(EstimatorError, match="filter 'baro-inertial' needs a baro; there is none"):
            check_needs(built, name, {"fixes"})
    if name == "loose-15":
        check_needs(built, name, {"fixes"})  # a barometer is used where there is one


def test_an_estimator_of_yours_states_its_needs():
    class Mine:
        needs = ("mag", "fixes")

    check_needs(Mine(), "mine", {"mag", "fixes"})
    with pytest.raises(EstimatorError, match=r"filter 'mine' needs a mag; there is none in \[sensors\]"):
        check_needs(Mine(), "mine", {"fixes"})
    Mine.needs = ("observations",)
    with pytest.raises(EstimatorError, match=r"needs a gnss at measurement level, one with \[sky\] such as"):
        check_needs(Mine(), "mine", {"fixes"})
    Mine.needs = ("sonar",)
    with pytest.raises(EstimatorError, match="needs 'sonar', expected one of fixes, observ"):
        check_needs(Mine(), "mine", {"fixes"})
    del Mine.needs
    check_needs(Mine(), "mine", set())


def test_the_contract_is_kept_by_an_estimator_of_ten_lines(sensed, tmp_path, monkeypatch):
    (tmp_path / "my_lab_standing.py").write_text(STANDING)
    monkeypatch.syspath_prepend(tmp_path)
    standing = load("my_lab_standing:Standing", {"drift": 40.0})
    assert standing.drift == 40.0
    bench.check_estimator(standing, sensed.data, sensed.initial)


# --- what the check sees --------------------------------------------------------------------------------


class Changed:
    """The loose filter with its solution changed before it is handed back."""

    def run(self, sensors, initial):
        return self.change(Loose().run(sensors, initial))


def changed_columns(solution, **values):
    columns = {f.name: getattr(solution, f.name) for f in fields(NavSolution)}
    return NavSolution(**{**columns, **values})


class TouchesItsInput:
    def run(self, sensors, initial):
        sensors.imu.dvel_b.base[0, 0] += 1e-9  # round the read-only view
        return Loose().run(sensors, initial)


class Remembers:
    calls = 0

    def run(self, sensors, initial):
        self.calls += 1
        return Loose().run(sensors, replace(initial, vel_n=initial.vel_n + 1e-12 * self.calls))


class Draws:
    def run(self, sensors, initial):
        noise = np.random.default_rng().normal(size=3)
        return Loose().run(sensors, replace(initial, vel_n=initial.vel_n + 1e-9 * noise))


class LosesItsOptionsInAPickle(Changed):
    def __init__(self):
        self.change = lambda solution: solution


class ForgetsItsOptionsInAPickle:
    def __init__(self, drift=0.0):
        self.drift = drift

    def __reduce__(self):
        return type(self), ()

    def run(self, sensors, initial):
        return Loose().run(sensors, replace(initial, vel_n=initial.vel_n + self.drift))


class Late(Changed):
    def change(self, solution):
        return changed_columns(solution, t=solution.t + 0.005)


class Short(Changed):
    def change(self, solution):
        columns = {f.name: getattr(solution, f.name) for f in fields(NavSolution)}
        table = ("extra_names", "innovations", "events")
        return NavSolution(**{k: v if k in table or v is None else v[:-1] for k, v in columns.items()})


class OneNanVariance(Changed):
    def change(self, solution):
        cov = solution.cov.copy()
        cov[7, 2, 2] = np.nan
        return changed_columns(solution, cov=cov)


class NoCovariance(Changed):
    def change(self, solution):
        return changed_columns(solution, cov=np.full_like(solution.cov, np.nan))


class OneNanCovariance(Changed):
    def change(self, solution):
        cov = solution.cov.copy()
        cov[7, 2, 5] = cov[7, 5, 2] = np.nan
        return changed_columns(solution, cov=cov)


class NegativeVariance(Changed):
    def change(self, solution):
        cov = solution.cov.copy()
        cov[7, 4, 4] *= -1
        return changed_columns(solution, cov=cov)


class Indefinite(Changed):
    def change(self, solution):
        cov = solution.cov.copy()
        cov[7, 0, 1] = cov[7, 1, 0] = 1.01 * np.sqrt(cov[7, 0, 0] * cov[7, 1, 1])
        return changed_columns(solution, cov=cov)


class Lopsided(Changed):
    def change(self, solution):
        cov = solution.cov.copy()
        cov[7, 0, 3] += 1e-6 * np.sqrt(cov[7, 0, 0] * cov[7, 3, 3])
        return changed_columns(solution, cov=cov)


class LosesItsPlace(Changed):
    def change(self, solution):
        lla = solution.lla.copy()
        lla[7] = np.nan
        return changed_columns(solution, lla=lla)


class LosesItsSpeed(Changed):
    def change(self, solution):
        vel_n = solution.vel_n.copy()
        vel_n[7, 2] = np.nan
        return changed_columns(solution, vel_n=vel_n)


class LosesItsAttitude(Changed):
    def change(self, solution):
        q_nb = solution.q_nb.copy()
        q_nb[7, 3] = np.nan
        return changed_columns(solution, q_nb=q_nb)


class ChangesByAnAnswer(Loose):
    """Its copies are not apart from it."""

    def in_pieces(self, first, initial, events):
        whole = super().in_pieces(first, initial, events)
        whole.copy = lambda: whole
        return whole


class LosesABitInPieces(Loose):
    def run(self, sensors, initial):
        return Loose().run(sensors, initial)

    def in_pieces(self, first, initial, events):
        return super().in_pieces(first, replace(initial, vel_n=initial.vel_n + 1e-9), events)


BREACHES = {
    LosesABitInPieces: "in pieces it gives other bits: lla differs",
    TouchesItsInput: "changed its input",
    Remembers: "not repeatable",
    Draws: "not repeatable",
    LosesItsOptionsInAPickle: "does not pickle",
    Late: "t is not sensors.output_t",
    Short: "t is not sensors.output_t",
    OneNanVariance: "covariance is not finite",
    OneNanCovariance: "covariance is not finite",
    NoCovariance: "no block of the solution has a covariance",
    NegativeVariance: "a variance is not positive",
    Indefinite: "not positive definite",
    Lopsided: "not symmetric",
    LosesItsPlace: "lla is not finite",
    LosesItsSpeed: "vel_n is not finite",
    LosesItsAttitude: "q_nb is not finite",
    ChangesByAnAnswer: "in pieces it gives other bits",
}


@pytest.mark.parametrize("broken", BREACHES)
def test_the_check_sees_each_way_to_break_the_contract(sensed, broken):
    """Each on its own copy of the increments: one of them writes into it."""
    data = replace(sensed.data, imu=replace(sensed.data.imu, dvel_b=sensed.data.imu.dvel_b.copy()))
    with pytest.raises(AssertionError, match=BREACHES[broken]):
        bench.check_estimator(broken(), data, sensed.initial)


def test_the_check_sees_options_that_a_pickle_forgets(sensed):
    bench.check_estimator(ForgetsItsOptionsInAPickle(), sensed.data, sensed.initial)
    with pytest.raises(AssertionError, match=r"not repeatable: lla differs from .*pickle"):
        bench.check_estimator(ForgetsItsOptionsInAPickle(1e-9), sensed.data, sensed.initial)


class TripsOverNaN(Changed):
    def run(self, sensors, initial):
        if np.isnan(sensors.fixes.lla).any():
            raise RuntimeError("a fix is NaN")
        return Loose().run(sensors, initial)


class TripsOverNothing(Changed):
    def run(self, sensors, initial):
        sensors.fixes.lla[0], sensors.baro.t[0]
        return Loose().run(sensors, initial)


class NeedsAnOutput(Changed):
    def change(self, solution):
        assert solution.lla[0, 2] > 0
        return solution


class PassesNaNOn(Changed):
    def run(self, sensors, initial):
        bad = np.isnan(sensors.baro.alt_baro).any()
        found = Loose().run(sensors, initial)
        return changed_columns(found, lla=np.full_like(found.lla, np.nan)) if bad else found


@pytest.mark.parametrize(
    ("weak", "message"),
    [
        (TripsOverNaN, r"with rows that are not finite: RuntimeError\('a fix is NaN'\)"),
        (TripsOverNothing, "with aiding records that have no rows: IndexError"),
        (NeedsAnOutput, "with no output times: IndexError"),
        (PassesNaNOn, "with rows that are not finite: AssertionError.*lla is not finite"),
    ],
)
def test_the_check_sees_what_an_estimator_does_not_stand(sensed, weak, message):
    with pytest.raises(AssertionError, match=message):
        bench.check_estimator(weak(), sensed.data, sensed.initial)


class NeedsTimes(Changed):
    """Copes with whatever is measured, at epochs that are known."""

    def run(self, sensors, initial):
        assert np.isfinite(sensors.fixes.t).all()
        return Loose().run(sensors, initial)


class NoAttitude(Changed):
    def change(self, solution):
        cov = solution.cov.copy()
        cov[:, 6:], cov[:, :, 6:] = np.nan, np.nan
        return changed_columns(solution, q_nb=np.full_like(solution.q_nb, np.nan), cov=cov)


@pytest.mark.parametrize("sound", [NoAttitude, NeedsTimes])
def test_what_is_no_breach(sensed, sound):
    """A block that is not estimated is NaN throughout; epochs of a record are finite."""
    bench.check_estimator(sound(), sensed.data, sensed.initial)


# --- the truth never enters -----------------------------------------------------------------------------

ALONE = """
import pickle, sys
from bench.navigation.built_in import load
with open(sys.argv[1], "rb") as file:
    data, initial = pickle.load(file)
solutions = {name: load(name, {}).run(one, initial) for name, one in data.items()}
seen = [m for m in sys.modules if m.startswith(("bench.", "jsbsim"))]
filter_run = sys.modules["bench.navigation.error_state_filter.filter_run"]
compiled = len(filter_run.fusion_kernel.dispatcher.signatures)
with open(sys.argv[2], "wb") as file:
    pickle.dump((solutions, seen, compiled), file)
"""


def test_estimators_need_nothing_but_the_record_and_the_start(sensed, tmp_path):
    """Another process that has the sensor record and the start, and no module that knows the truth."""
    given, made = tmp_path / "given.pickle", tmp_path / "made.pickle"
    here = [name for name, row in BUILT_IN.items() if not row.package or find_spec(row.package)]
    data = {name: shorten(sensed.data, name) for name in here}
    given.write_bytes(pickle.dumps((data, sensed.initial)))
    subprocess.run([sys.executable, "-c", ALONE, given, made], check=True, timeout=300)
    solutions, seen, compiled = pickle.loads(made.read_bytes())
    truth_side = ("flight", "sensors", "evaluation", "pipeline", "store", "config")
    assert not [m for m in seen if m.split(".")[-1] == "jsbsim" or m.split(".")[1] in truth_side]
    for name, solution in solutions.items():
        assert_same_solution(solution, load(name, {}).run(data[name], sensed.initial))
    assert compiled == 1  # one kernel for all of them: records and their absence look the same to it


# --- loading --------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("use", "options", "message"),
    [
        (
            "lose-15",
            {},
            "no filter 'lose-15'; there are loose-15, loose-22, loose-mems, loose-full, tight,",
        ),
        ("smother", {}, "no filter 'smother'; there are"),
        ("", {}, "no filter ''; there are"),
        (":Class", {}, "no filter ':Class'; there are"),
        (".here:Class", {}, "no filter '.here:Class'; there are"),
        ("not_a_lab:Class", {}, "filter 'not_a_lab:Class': no module 'not_a_lab' on the Python path"),
        ("bench.nowhere:Class", {}, "no module 'bench.nowhere' on the Python path"),
        (
            "bench.core.records.data:Nothing",
            {},
            "bench.core.records.data has no class 'Nothing' with a method run",
        ),
        (
            "bench.core.records.data:NavSolution",
            {},
            "bench.core.records.data has no class 'NavSolution' with a method run",
        ),
        (
            "loose-15",
            {"gate": 1},
            "unknown option 'gate'. Did you mean 'gate_probability'?\n  known options: adaptive_noise",
        ),
        ("free-inertial", {"gnss": True}, "option 'gnss' is fixed to false; leave it out"),
        ("error-ekf", {"admissible_deg": 2.0}, "option 'admissible_deg' is fixed to 1; leave it out"),
        (
            "free-inertial",
            {"gate": 1},
            "unknown option 'gate'. Did you mean 'gate_probability'?\n  known options: adaptive_noise",
        ),
        ("loose-15", {"covariance_hz": 0.0}, "covariance_hz = 0 Hz must be positive"),
        ("loose-15", {"covariance_hz": float("nan")}, "covariance_hz = nan Hz must be a finite number"),
        ("loose-15", {"covariance_hz": "fast"}, "covariance_hz = 'fast' must be a number"),
        ("loose-15", {"gate_probability": 1.0}, "gate_probability = 1 must be between 0 and 1"),
        ("loose-15", {"readmit_after_s": -1.0}, "readmit_after_s = -1 s must be 0 or more"),
    ],
)
def test_an_estimator_that_cannot_be_built_says_why(use, options, message):
    with pytest.raises(EstimatorError) as caught:
        load(use, options)
    assert message in str(caught.value)


def test_an_error_inside_a_users_module_keeps_its_own_kind(tmp_path, monkeypatch):
    """A missing import of the user's is not a missing filter, even where the names begin alike."""
    (tmp_path / "lab_broken.py").write_text("1 / 0\n")
    (tmp_path / "lab_of_one.py").write_text("import lab_of\n")
    monkeypatch.syspath_prepend(tmp_path)
    with pytest.raises(ZeroDivisionError):
        load("lab_broken:Class", {})
    with pytest.raises(ModuleNotFoundError, match="lab_of"):
        load("lab_of_one:Class", {})


def test_a_users_estimator_with_open_keywords_gets_them_all(tmp_path, monkeypatch):
    (tmp_path / "lab_open.py").write_text(
        "class Open:\n"
        "    def __init__(self, **options): self.options = options\n"
        "    def run(self, sensors, initial): ...\n"
    )
    monkeypatch.syspath_prepend(tmp_path)
    assert load("lab_open:Open", {"huber_k": 1.5}).options == {"huber_k": 1.5}


# --- options have their effect ----------------------------------------------------------------------------


def rmse(values):
    return {name: value for name, value in values.items() if "_rmse_" in name}


def test_the_covariance_at_20_hz_keeps_every_rmse_within_one_percent():
    """Three runs of three minutes; and the distance from full rate grows as the rate falls."""
    truth = weaving(180.0)
    for run in range(3):
        sensed = sensors.sense(truth, units(), 2, run)
        found = {}
        for hz in (None, 20.0):
            solution = Loose(covariance_hz=hz).run(sensed.data, sensed.initial)
            found[hz] = rmse(
                run_metrics.measure(truth, solution, evaluation=EvaluationWindow(60.0), outages=())[1]
            )
        assert len(found[None]) > 20
        for name, value in found[None].items():
            assert abs(found[20.0][name] / value - 1) < 0.01, name
    data = replace(sensed.data, baro=None, output_t=sensed.data.output_t[::10])  # none of them forces a step
    full = Loose(covariance_hz=None).run(data, sensed.initial)
    distance = [
        np.abs(Loose(covariance_hz=hz).run(data, sensed.initial).vel_n - full.vel_n).max()
        for hz in (100.0, 20.0, 4.0, 1.0)
    ]
    assert 0 < distance[0] < distance[1] < distance[2] < distance[3]


def test_a_slower_covariance_with_a_defect_would_leave_the_one_percent():
    """Q of one sample instead of the ten of a step: what such a defect looks like."""
    truth = weaving(180.0)
    sensed = sensors.sense(truth, units(), 2, 0)
    imu = replace(
        IMU,
        gyro=replace(IMU.gyro, random_walk=IMU.gyro.random_walk / 10**0.5),
        accel=replace(IMU.accel, random_walk=IMU.accel.random_walk / 10**0.5),
    )
    wrong = replace(sensed.data, specs=replace(sensed.data.specs, imu=imu))
    found = [
        rmse(run_metrics.measure(truth, solution, evaluation=EvaluationWindow(60.0), outages=())[1])
        for solution in (Loose(covariance_hz=None).run(data, sensed.initial) for data in (sensed.data, wrong))
    ]
    assert max(abs(found[1][name] / value - 1) for name, value in found[0].items()) > 0.01


def refused(solution):
    """How many sub-vectors were rejected."""
    first = solution.innovations.component == 0
    return int((~solution.innovations.accepted[first]).sum())


def test_a_gate_refuses_the_share_it_is_told(truth):
    """Binomial 99.9 % bounds of 3 x 30 fixes and 150 heights in 8 runs, innovations of a matched filter."""
    from scipy.stats import binom

    data = [sensors.sense(truth, units(), 3, run) for run in range(8)]
    counts = {}
    for probability in (1e-5, 0.01, 0.2):
        counts[probability] = sum(
            refused(Loose(gate_probability=probability, readmit_after_s=1000.0).run(s.data, s.initial))
            for s in data
        )
    total = 8 * (2 * 30 + 150)
    assert counts[1e-5] <= binom.ppf(0.9995, total, 1e-5)
    assert binom.ppf(0.0005, total, 0.01) <= counts[0.01] <= binom.ppf(0.9995, total, 0.01)
    assert counts[0.2] > binom.ppf(
        0.9995, total, 0.01
    )  # rejecting a fifth unsettles the filter: no bound above


@pytest.mark.parametrize(("after", "refusals"), [(0.0, 3), (2.5, 3), (4.0, 4), (9.0, 9)])
def test_a_sub_vector_is_used_again_after_seconds_of_refusals_and_at_least_three(sensed, after, refusals):
    """The receiver, of 1 Hz, is 1 km off from 10 s on."""
    fixes = sensed.data.fixes
    lla = fixes.lla.copy()
    lla[fixes.t > 9.5, 0] += 1000.0 / 6.37e6
    columns = {f.name: getattr(fixes, f.name) for f in fields(fixes)}
    data = replace(sensed.data, fixes=type(fixes)(**{**columns, "lla": lla}))
    innovations = Loose(readmit_after_s=after).run(data, sensed.initial).innovations
    position = (innovations.code == innovations.sensor.index("gnss_position")) & (innovations.component == 0)
    accepted = innovations.accepted[position]
    assert accepted[:9].all()
    assert_array_equal(accepted[9 : 10 + refusals], [False] * refusals + [True])


@pytest.mark.parametrize("option", ["gnss", "baro"])
def test_aiding_switched_off_is_aiding_absent(sensed, option):
    record = {"gnss": "fixes", "baro": "baro"}[option]
    off = Loose(**{option: False}).run(sensed.data, sensed.initial)
    assert_same_solution(off, Loose().run(replace(sensed.data, **{record: None}), sensed.initial))
    assert not np.array_equal(off.lla, Loose().run(sensed.data, sensed.initial).lla)


# --- a filter that diverges is a result -------------------------------------------------------------------

ABSURD = {
    "GNSS that reports a nanometer": {"gnss": replace(GNSS, pos_h_white_sd=1e-9, pos_v_white_sd=1e-9)},
    "GNSS without noise": {"gnss": replace(GNSS, pos_h_white_sd=0.0, pos_v_white_sd=0.0, vel_white_sd=0.0)},
    "GNSS of NaN": {"gnss": replace(GNSS, pos_h_white_sd=np.nan)},
    "baro that reports a nanometer": {"baro": replace(BARO, white_sd=1e-9, bias_sd=0.0, bias_walk=0.0)},
    "gyro noise of NaN": {"imu": replace(IMU, gyro=replace(IMU.gyro, random_walk=np.nan))},
    "gyro noise beyond reason": {"imu": replace(IMU, gyro=replace(IMU.gyro, random_walk=1e150))},
    "accelerometer noise beyond reason": {"imu": replace(IMU, accel=replace(IMU.accel, random_walk=1e150))},
}


@pytest.mark.parametrize("case", ABSURD)
def test_a_filter_that_diverges_is_a_result(truth, sensed, case):
    data = replace(sensed.data, specs=replace(sensed.data.specs, **ABSURD[case]))
    solution = Loose(readmit_after_s=0.0).run(data, sensed.initial)
    assert_array_equal(solution.t, data.output_t)
    _, judged = run_metrics.measure(truth, solution, evaluation=EvaluationWindow(10.0), outages=())
    assert "converged" in judged


def test_a_filter_of_nan_did_not_converge(truth, sensed):
    data = replace(sensed.data, specs=replace(sensed.data.specs, **ABSURD["gyro noise of NaN"]))
    solution = Loose(readmit_after_s=0.0).run(data, sensed.initial)
    assert np.isnan(solution.lla[solution.t < 20.0][-1]).all()  # until the fixes alone begin it anew
    _, judged = run_metrics.measure(truth, solution, evaluation=EvaluationWindow(10.0), outages=())
    assert judged["converged"] is False
    _, judged = run_metrics.measure(
        truth, Loose().run(sensed.data, sensed.initial), evaluation=EvaluationWindow(10.0), outages=()
    )
    assert judged["converged"] is True
