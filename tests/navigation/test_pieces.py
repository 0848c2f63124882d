"""A filter that takes a record in pieces says of it, bit for bit, what it says of the whole."""

from __future__ import annotations

from dataclasses import fields, replace
from functools import cache
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose, assert_array_equal

import bench
from bench.core.files import disk_arrays
from bench.core.words.exceptions import EstimatorError
from bench.io import config
from bench.navigation import built_in
from bench.navigation.start import restart
from bench.simulation import sensors
from tests.builders import assert_same_solution, at_rest, put, take
from tests.weaving import BARO, DEG, GNSS, IMU, units, weaving

END = 12.0
LATE = 0.23  # of the fixes [s]: they arrive between samples, and between steps of the covariance
USES = {
    "loose-15": {},
    "loose-22": {"covariance_hz": None},
    "loose-mems": {"lever_arm_sd": 0.1, "adaptive_noise": 30},
    "loose-full": {"coordinated": True, "integrity": ["nis", "velocity"]},
    "tight": {},
    "baro-inertial": {},
    "free-inertial": {},
    "loose-15 at rest": {"standstill": True, "nonholonomic": True, "integrity": ["velocity"]},
    "loose-full with wild gyros": {},
}
SEVERAL = {
    "loose-22 with silences": {},
    "tight with silences": {},
    "loose-15 from any heading": {},
}
"""Cases in which several filters run."""
OTHERS = {
    "gnss-only": {},
    "ukf": {"covariance_hz": 7.0},
    "classic-22": {"integrity": ["nis", "tolerance"], "feedback": False, "outage": "line"},
    "classic-22 in single precision": {"covariance_precision": "single", "form": "carlson"},
    "error-ekf": {},
    "fixed-gain": {},
    "complementary": {},
    "least-squares": {},
    "invariant-ekf": {},
    "ahrs": {"gravity_period_s": 0.3},
}


@cache
def drawn():
    """Fixes at 5 Hz and a barometer at 20 Hz, both late, some of them bad; a short gap in the IMU."""
    gnss = replace(GNSS, rate=5.0, latency=LATE)
    sensed = sensors.sense(weaving(END, 100.0), units(gnss=gnss, baro=replace(BARO, latency=0.04)), 1, 0)
    data = sensed.data
    fixes = put(data.fixes, 20, lla=data.fixes.lla[20] + [1e-4, 0.0, 0.0])
    fixes = put(put(fixes, 22, vel_n=[np.nan] * 3), 25, valid=False)
    imu = put(data.imu, 700, dvel_b=[np.nan] * 3)
    imu = take(imu, (imu.t < 4.0) | (imu.t > 4.3))
    output_t = np.union1d(data.output_t, [3.0004, 4.1, 4.17, 7.003, 7.0071])
    return sensed.initial, replace(data, imu=imu, fixes=fixes, output_t=output_t)


@cache
def drawn_short():
    """The first half of it, for filters that are slow."""
    initial, data = drawn()
    return initial, bench.slice_sensors(data, -1.0, 6.5)


@cache
def drawn_satellites():
    gnss = config.read_profile("figure-eight", {"sensors.gnss": "sky-l1"}).sensors.gnss
    sensed = sensors.sense(weaving(END, 100.0), units(gnss=replace(gnss, latency=LATE)), 1, 0)
    return sensed.initial, sensed.data


@cache
def drawn_satellites_with_silences():
    initial, data = drawn_satellites()
    t = data.imu.t
    return initial, replace(data, imu=take(data.imu, (t <= 0.4 * END) | (t > 0.4 * END + 1.5)))


@cache
def drawn_at_rest():
    """A short gap and a fix off by 60 m."""
    sensed = sensors.sense(at_rest(END, 100.0, drawn()[0].lla, heading=0.4), units(baro=None), 1, 0)
    fixes, imu = sensed.data.fixes, sensed.data.imu
    fixes = put(fixes, 6, lla=fixes.lla[6] + [1e-5, 0.0, 0.0])
    return sensed.initial, replace(sensed.data, fixes=fixes, imu=take(imu, (imu.t < 4.0) | (imu.t > 4.3)))


@cache
def drawn_with_silences():
    """No IMU for 2 s at the start of a turn, for 1 s in the alignment after that, and for 3 s later on."""
    sensed = sensors.sense(weaving(44.0, 50.0), units(gnss=replace(GNSS, rate=2.0, latency=LATE)), 1, 0)
    imu = sensed.data.imu
    for begin, end in ((5.0, 7.0), (10.0, 11.0), (25.0, 28.0)):
        imu = take(imu, (imu.t <= begin) | (imu.t > end))
    return sensed.initial, replace(sensed.data, imu=imu)


@cache
def drawn_lost():
    """A heading that is not known and found after a minute."""
    sensed = sensors.sense(weaving(66.0, 20.0), units(baro=None), 1, 0)
    cov = np.diag(np.append(np.diag(sensed.initial.cov)[:8], np.pi**2))
    return replace(sensed.initial, cov=cov), replace(sensed.data, output_t=sensed.data.output_t[::4])


@cache
def drawn_wild():
    """Gyros with a turn-on bias of degrees per second, and 20 s straight ahead."""
    wild = replace(IMU, gyro=replace(IMU.gyro, turn_on_bias_sd=2.0 * DEG))
    sensed = sensors.sense(weaving(26.0, 50.0, straight_from=0.0), units(wild), 1, 0)
    return sensed.initial, sensed.data


@cache
def whole(use):
    initial, data = record(use)
    return loaded(use).run(data, initial)


def loaded(use):
    return built_in.load(use.split()[0], (USES | SEVERAL | OTHERS)[use])


def record(use):
    special = {
        "tight": drawn_satellites,
        "loose-15 at rest": drawn_at_rest,
        "loose-22 with silences": drawn_with_silences,
        "tight with silences": drawn_satellites_with_silences,
        "loose-15 from any heading": drawn_lost,
        "loose-full with wild gyros": drawn_wild,
    }
    return (special | dict.fromkeys(OTHERS, drawn_short)).get(use, drawn)()


def pieces(data, cuts):
    edges = [-1.0, *sorted(cuts), np.inf]
    return [bench.slice_sensors(data, begin, end) for begin, end in pairwise(edges)]


def joined(solutions):
    """Return the answers of all pieces as one solution, without events."""
    found = [one for one in solutions if one.extra_names == solutions[-1].extra_names]
    columns = {
        f.name: np.concatenate([getattr(one, f.name) for one in found])
        for f in fields(found[0])
        if f.name not in ("extra_names", "innovations", "events") and getattr(found[0], f.name) is not None
    }
    tables = [one.innovations for one in found if len(one.innovations)]
    if tables:
        names = [f.name for f in fields(tables[0]) if f.name != "sensor"]
        rows = {name: np.concatenate([getattr(one, name) for one in tables]) for name in names}
        columns["innovations"] = replace(tables[0], **rows)
    return replace(found[0], **columns)


def opened(use, **more):
    initial, data = record(use)
    return bench.open_filter(
        use.split()[0], initial, (USES | SEVERAL | OTHERS)[use], look_back=0.5, **more
    ), data


CUTS = {
    "cuts": st.lists(st.floats(0.0, END), min_size=1, max_size=12),
    "asked": st.sets(st.integers(0, 12)),
}


@pytest.mark.parametrize("use", USES)
@settings(max_examples=8, deadline=None, derandomize=True)
@given(**CUTS)
def test_wherever_the_record_is_cut_and_whatever_is_asked_the_bits_are_those_of_the_whole(use, cuts, asked):
    assert_bits_of_the_whole(use, cuts, asked)


@pytest.mark.parametrize("use", SEVERAL)
@settings(max_examples=2, deadline=None, derandomize=True)
@given(**CUTS)
def test_several_filters_in_pieces_have_the_bits_of_the_whole_too(use, cuts, asked):
    assert_bits_of_the_whole(use, cuts, asked)


def assert_bits_of_the_whole(use, cuts, asked):
    filter_, data = opened(use)
    found = []
    length = data.imu.t[-1] / END
    for k, piece in enumerate(pieces(data, [length * cut for cut in cuts])):
        found.append(filter_.update(piece))
        if k in asked:
            filter_.current()
    last = filter_.current()
    found.append(filter_.finish())
    expected = whole(use)
    assert_same_solution(joined(found), expected)
    assert last.t[0] == expected.t[-1]
    for name in ("lla", "vel_n", "q_nb", "cov", "extra", "extra_sd"):
        assert_array_equal(getattr(last, name)[0], getattr(expected, name)[-1], err_msg=name)


@pytest.mark.parametrize("use", OTHERS)
def test_the_filters_that_are_not_compiled_end_with_the_bits_of_the_whole_too(use, tmp_path):
    """Cut anywhere, asked between, saved and gone on with; the first piece has one sample, others none."""
    draw = np.random.default_rng(len(use))
    filter_, data = opened(use)
    found = []
    for k, piece in enumerate(pieces(data, [0.01, 4.15, 4.151, *draw.uniform(0.0, 6.5, 7)])):
        found.append(filter_.update(piece))
        if k % 3 == 0:
            filter_ = bench.read_filter(bench.write_filter(filter_, tmp_path / "filter.npz"))
        if k % 2:
            filter_.current()
    last = filter_.current()
    found.append(filter_.finish())
    expected = whole(use)
    assert_same_solution(joined(found), expected)
    assert last.t[0] == expected.t[-1]
    for name in ("lla", "vel_n", "q_nb", "cov", "extra", "extra_sd"):
        assert_array_equal(getattr(last, name)[0], getattr(expected, name)[-1], err_msg=name)


@pytest.mark.parametrize("use", [*USES, "loose-22 with silences"])
def test_a_long_record_goes_through_a_filter_in_blocks_with_the_bits_of_the_whole(use, monkeypatch):
    """Its events, too: what is counted over all blocks, and rejections that go on from one to the next."""
    initial, data = record(use)
    if data.baro is not None:  # from 5.05 to 8 s rejected, over the ends of two blocks
        alt_baro = np.where((data.baro.t > 5.03) & (data.baro.t < 8.0), 1e5, data.baro.alt_baro)
        t_arrival = np.where(data.baro.t < 9.0, data.baro.t_arrival, np.nan)
        data = replace(data, baro=replace(data.baro, alt_baro=alt_baro, t_arrival=t_arrival))
    expected = loaded(use).run(data, initial)
    for rows in (83, 290):
        monkeypatch.setattr(disk_arrays, "ROWS", rows)
        monkeypatch.setattr(disk_arrays, "LARGE", 0)
        found = loaded(use).run(data, initial)
        assert_same_solution(found, expected)
        assert sorted(found.events.rows()) == sorted(expected.events.rows())
    if data.baro is not None and use != "free-inertial" and "silences" not in use:
        assert any("in a row rejected" in text for text in expected.events.text)
        assert any("rows left out: flagged or not finite" in text for text in expected.events.text)


def test_what_looks_over_seconds_finds_something():
    """A standstill, samples of a vehicle, and a fix that the velocities do not bear out."""
    for use, names in (
        ("loose-15 at rest", {"zero_velocity", "zero_rate", "nonholonomic"}),
        ("loose-full", {"coordinated"}),
    ):
        found = whole(use)
        assert names <= {found.innovations.sensor[code] for code in found.innovations.code}
        assert [text for *_, text in found.events.select("integrity")] == [
            "1 positions disagree with the velocities of the receiver"
        ]


def test_pieces_of_one_sample_make_the_whole():
    filter_, data = opened("loose-15")
    found = [filter_.update(piece) for piece in pieces(data, data.imu.t[:-1])]
    assert_same_solution(joined([*found, filter_.finish()]), whole("loose-15"))


def test_an_answer_is_that_of_a_record_that_ends_there():
    filter_, data = opened("loose-22")
    initial = record("loose-22")[0]
    for begin, end in ((-1.0, 3.3), (3.3, 7.13)):
        filter_.update(bench.slice_sensors(data, begin, end))
        answer = filter_.current()
        ended = replace(bench.slice_sensors(data, -1.0, end), output_t=answer.t)
        expected = built_in.load("loose-22", USES["loose-22"]).run(ended, initial)
        for name in ("lla", "vel_n", "q_nb", "cov", "extra"):
            assert_array_equal(getattr(answer, name), getattr(expected, name), err_msg=name)
        assert end - 0.02 < answer.t[0] <= end


def test_asking_changes_no_bit_of_a_whole_record():
    """An answer does not end a step of the covariance, whose rate is below that of the answers here."""
    initial, data = drawn()
    rare = replace(data, output_t=data.output_t[-1:])
    often = replace(data, output_t=np.arange(0.0, data.imu.t[-1], 0.013))
    often = replace(often, output_t=np.append(often.output_t, data.output_t[-1]))
    a, b = (built_in.load("loose-15", {"covariance_hz": 7.0}).run(one, initial) for one in (rare, often))
    for name in ("lla", "vel_n", "q_nb", "cov", "extra"):
        assert_array_equal(getattr(a, name)[-1], getattr(b, name)[-1], err_msg=name)


def test_an_answer_between_samples_lies_on_the_way_between_them():
    initial, data = drawn()
    times = np.array([6.99, 6.9931, 7.0])
    solution = built_in.load("loose-15", {}).run(replace(data, output_t=times), initial)
    share = (times[1] - times[0]) / (times[2] - times[0])
    for name, slack in (("lla", 1e-11), ("vel_n", 2e-2)):
        one = getattr(solution, name)
        assert_allclose(one[1], one[0] + share * (one[2] - one[0]), atol=slack)
    variance = np.einsum("kii->ki", solution.cov)[:, 6:]
    assert ((variance[1] - variance[0]) * (variance[2] - variance[1]) >= 0).all()


def test_a_saved_filter_goes_on_as_if_it_had_not_stopped(tmp_path):
    for use in (
        "loose-22",
        "tight",
        "loose-15 at rest",
        "loose-full",
        "loose-full with wild gyros",
        *SEVERAL,
    ):
        filter_, data = opened(use)
        found = []
        for piece in pieces(data, [0.3, 6.1, 9.01, 29.5]):
            found.append(filter_.update(piece))
            filter_ = bench.read_filter(bench.write_filter(filter_, tmp_path / "filter.npz"))
        found.append(filter_.finish())
        assert_same_solution(joined(found), whole(use))


def test_a_damaged_or_foreign_file_is_refused(tmp_path):
    filter_, data = opened("loose-15")
    filter_.update(bench.slice_sensors(data, -1.0, 3.0))
    place = bench.write_filter(filter_, tmp_path / "filter.npz")
    content = bytearray(place.read_bytes())
    content[content.index(b"carried.npy") + 200] ^= 1
    place.write_bytes(content)
    with pytest.raises(EstimatorError, match="holds no filter that bench saved"):
        bench.read_filter(place)
    with np.load(bench.write_filter(filter_, place)) as file:
        arrays = dict(file)
    arrays["/passage/filter/run/now/state"] = arrays["/passage/filter/run/now/state"] + 1e-9
    np.savez(place, **arrays)
    with pytest.raises(EstimatorError, match="changed or damaged"):
        bench.read_filter(place)
    with pytest.raises(EstimatorError, match="no data to save"):
        bench.write_filter(opened("loose-15")[0], place)


def test_what_comes_too_late_or_does_not_follow_is_refused_and_changes_nothing():
    filter_, data = opened("loose-15")
    found = [filter_.update(bench.slice_sensors(data, -1.0, 6.0))]
    old = take(data.fixes, (data.fixes.t > 4.9) & (data.fixes.t < 5.1))
    piece = bench.slice_sensors(data, 6.0, 9.0)
    wrong = {
        "longer look_back": replace(piece, output_t=np.array([2.0])),
        "order of arrival": replace(piece, fixes=old),
        "a record without rows": replace(piece, baro=None),
        "datasheets": replace(piece, specs=replace(piece.specs, baro=replace(BARO, white_sd=9.0))),
        "ground height": replace(piece, ground_alt=1e3),
    }
    for words, bad in wrong.items():
        with pytest.raises(EstimatorError, match=words):
            filter_.update(bad)
    found += [filter_.update(piece), filter_.update(bench.slice_sensors(data, 9.0, np.inf)), filter_.finish()]
    assert_same_solution(joined(found), whole("loose-15"))
    with pytest.raises(EstimatorError, match="is finished"):
        filter_.update(piece)


@pytest.mark.parametrize(("use", "without"), [("loose-15", ()), ("tight", ("observations",))])
def test_satellites_that_are_not_used_or_not_there_leave_a_long_record_as_it_is(use, without, monkeypatch):
    initial, data = drawn_satellites()
    data = replace(data, **dict.fromkeys(without))
    expected = built_in.load(use, {}).run(data, initial)
    monkeypatch.setattr(disk_arrays, "ROWS", 290)
    monkeypatch.setattr(disk_arrays, "LARGE", 0)
    found = built_in.load(use, {}).run(data, initial)
    assert_same_solution(found, expected)
    assert sorted(found.events.rows()) == sorted(expected.events.rows())


@pytest.mark.parametrize(
    ("use", "behind", "feeds"), [("loose-15", 1.5, range(2, 4)), ("ukf", 0.1, range(25, 35))]
)
def test_answers_come_after_the_look_back_and_a_stride(use, behind, feeds):
    """In pieces of 50 ms: a second after what may still be late, a tenth of it where nothing waits."""
    filter_, data = opened(use)
    worst, answered, newest = 0.0, 0, 0.0
    for begin, end in pairwise(np.arange(0.0, 3.01, 0.05)):
        found = filter_.update(bench.slice_sensors(data, begin, end))
        answered += len(found) > 0
        newest = found.t[-1] if len(found) else newest
        worst = max(worst, end - newest)
    assert behind <= worst < behind + 0.06
    assert answered in feeds


def test_a_measurement_later_than_the_filter_looks_back_is_refused():
    initial, data = drawn()
    data = replace(data, fixes=replace(data.fixes, t_arrival=data.fixes.t + 1.9))
    filter_ = bench.open_filter("loose-15", initial, look_back=0.5)
    filter_.update(bench.slice_sensors(data, -1.0, 2.6))
    with pytest.raises(EstimatorError, match=r"a row of gnss for 0\.8 s comes when the filter"):
        filter_.update(bench.slice_sensors(data, 2.6, 3.0))
    patient = bench.open_filter("loose-15", initial, look_back=2.0)
    found = [patient.update(piece) for piece in pieces(data, [2.6, 3.0, 7.7])]
    expected = built_in.load("loose-15", {}).run(data, initial)
    assert_same_solution(joined([*found, patient.finish()]), expected)


@pytest.mark.parametrize("alignment", ["level", "course"])
def test_a_filter_that_has_to_align_itself_waits_for_its_start(alignment, tmp_path):
    """At rest with a given heading, and on the move without anything given."""
    initial, data = drawn()
    unknown, wide = np.full(4, np.nan), np.diag(np.full(9, np.inf))
    start = replace(
        initial, lla=unknown[:3], vel_n=unknown[:3], q_nb=unknown, cov=wide, alignment=alignment,
        align_for=3.0, drift_sd=0.05,
    )  # fmt: skip
    if alignment == "level":
        standing = sensors.sense(at_rest(END, 100.0, initial.lla, heading=0.4), units(), 1, 0)
        wide[:3, :3], wide[8, 8] = initial.cov[:3, :3], 0.1**2
        data = standing.data
        start = replace(start, lla=standing.initial.lla, q_nb=standing.initial.q_nb, cov=wide)
    filter_ = bench.open_filter("loose-15", start, look_back=0.5)
    found = []
    for piece in pieces(data, np.arange(0.1, END, 0.37)):
        found.append(filter_.update(piece))
        filter_ = bench.read_filter(bench.write_filter(filter_, tmp_path / "filter.npz"))
    assert len(found[3]) == 0
    assert_same_solution(joined([*found, filter_.finish()]), built_in.load("loose-15", {}).run(data, start))


def test_a_start_that_cannot_be_found_is_said():
    initial, data = drawn()
    wide = np.diag(np.append(np.diag(initial.cov)[:3], np.full(6, np.inf)))
    start = replace(initial, cov=wide, alignment="level", align_for=3.0)
    filter_ = bench.open_filter("loose-15", start, look_back=0.5)
    filter_.update(bench.slice_sensors(data, -1.0, 4.0))
    assert np.isnan(filter_.current().lla).all()
    with pytest.raises(EstimatorError, match="alignment level needs a standstill"):
        filter_.update(bench.slice_sensors(data, 4.0, 9.0))


@pytest.mark.parametrize(
    ("use", "options", "words"),
    [
        ("smoother", {}, "'smoother' cannot run in pieces: it has no method in_pieces"),
        ("loose-15", {"covariance_hz": -1.0}, "covariance_hz"),
        ("loose", {}, "no filter 'loose'"),
        *(
            ("loose-15", {"look_back": seconds}, f"look_back = {seconds} must be 0 or more, in seconds")
            for seconds in (-0.1, np.inf)
        ),
    ],
)
def test_what_cannot_run_in_pieces_says_so(use, options, words):
    more = {name: options.pop(name) for name in ("look_back",) if name in options}
    with pytest.raises(EstimatorError, match=words):
        bench.open_filter(use, drawn()[0], options, **more)


@pytest.mark.parametrize("use", ["loose-15", "gnss-only", "ukf", "error-ekf"])
def test_memory_does_not_grow_with_the_record(use, monkeypatch):
    """What a filter carries after six times as long is the same, though no answer is wanted.

    After a rejected fix there is a copy of it beside it, and the record since, for a while.
    """
    monkeypatch.setattr(restart, "LONGEST_KEPT", 2.0)
    filter_, (_, data) = opened(use)[0], drawn()
    data, sizes = replace(data, output_t=data.output_t[:0]), []
    for begin in range(12):
        filter_.update(bench.slice_sensors(data, begin - 1.0, float(begin)))
        sizes.append(count(filter_.state()["passage"]))
    beside = 2.6 if use == "loose-15" else 1.1
    assert max(sizes[6:]) <= beside * max(sizes[3:6])


def count(state):
    """Return how many numbers a state holds."""
    parts = state.values() if isinstance(state, dict) else state if isinstance(state, list | tuple) else ()
    return np.size(state) if not parts else sum(count(part) for part in parts)
