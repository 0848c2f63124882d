"""Hypotheses of a heading by hand: filters that say what the test wants stand for those of the headings."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose

from bench.core.mathematics import earth, rotation
from bench.core.records.data import Events, InitialState, Innovations, NavSolution
from bench.core.records.sensor_specs import ImuSpec, TriadSpec
from bench.navigation.engine.record_cuts import slice_sensors, take_head
from bench.navigation.start import headings
from bench.simulation import sensors
from tests.builders import at_rest
from tests.weaving import DEG, units

LLA = np.array([0.8, 0.2, 500.0])
NAMES = ("gnss_position", "gnss_velocity", "baro", "zero_velocity", "magnetometer")


class Scripted:
    """A filter that keeps its heading and says of each second how likely it is; its states are its own."""

    def __init__(self, k, start, nis):
        self.k, self.start, self.end, self.nis = k, start, start.t, nis
        rng = np.random.default_rng(k)
        self.off, root = rng.normal(size=6), 0.02 * rng.normal(size=(9, 9))
        self.cov, self.extra = root @ root.T, np.array([k * 0.1, 2.0])
        self.said = 0
        self.heading_lost_at = None

    def update(self, piece, look_back, *, last):
        before, self.end = self.end, max(self.end, piece.imu.t.max(initial=self.end))
        t = piece.output_t
        tile = (len(t), 1)
        at = np.arange(np.floor(before) + 1.0, self.end + 1e-9)
        rows = [(one, 0, c, 0.3, 1.0, self.nis(self.k, one), True) for one in at for c in (0, 1)]
        self.said += 1
        text = [(float(before), float(self.end), "note", f"{self.k} fed for the {self.said}. time", "")]
        return NavSolution(
            t,
            earth.displace(np.tile(LLA, tile), np.tile(self.off[:3], tile)),
            np.tile(np.array([20.0, 5.0, 0.0]) + self.off[3:], tile),
            np.tile(self.start.q_nb, tile),
            np.tile(np.full(3, self.k), tile),
            np.tile(np.full(3, -self.k), tile),
            np.tile(self.cov, (len(t), 1, 1)),
            ("a", "b"),
            np.tile(self.extra, tile),
            np.tile([0.5, 0.7], tile),
            innovations=Innovations.from_rows(NAMES, rows),
            events=Events.from_rows(text),
        )


def begun(nis, heading_sd=np.pi):
    """A record of 260 s with an answer every 5 s, and the hypotheses of it."""
    truth = at_rest(260.0, 1.0, LLA, heading=0.3)
    spec = replace(units(ImuSpec("perfect", TriadSpec(), TriadSpec()), baro=None), output_rate=0.2)
    sensed = sensors.sense(truth, spec, 1, 0)
    cov = sensed.initial.cov.copy()
    cov[:, 8] = cov[8] = 0.0
    cov[8, 8] = heading_sd**2
    made = []

    def begin(_, start, events):
        made.append(Scripted(len(made), start, nis))
        return made[-1]

    start = replace(sensed.initial, cov=cov)
    return headings.ManyHeadings(begin, take_head(sensed.data), start, []), sensed.data, made


def told(k, t):
    """The twelfth hypothesis is e times as likely as others by each measurement, that behind it far more."""
    return {12: 1.0, 4: 30.0}.get(k, 3.0)


def at(record, begin, end):
    return slice_sensors(record, begin, end)


def test_the_estimate_is_the_leading_one_with_the_mean_square_of_its_error_over_all():
    """Five measurements leave the others weights of exp(-5); the Jacobian by differences."""
    filter_, data, made = begun(told)
    found = filter_.update(at(data, -1.0, 7.0), 0.5, last=False)
    assert found.t.tolist() == [0.0, 5.0]
    w = np.exp(-2.5 * (np.array([told(k, 0.0) for k in range(16)]) - 1.0))
    w /= w.sum()
    lead = made[12]
    place = earth.displace(LLA, lead.off[:3])
    assert_allclose(found.lla[1], place)
    assert_allclose(found.vel_n[1], np.array([20.0, 5.0, 0.0]) + lead.off[3:])
    assert_allclose(found.q_nb[1], lead.start.q_nb)
    assert found.gyro_bias_b[1, 0] == 12.0
    assert found.accel_bias_b[1, 0] == -12.0
    wanted, variance = np.zeros((9, 9)), np.zeros(2)
    for one, weight in zip(made, w, strict=True):
        turn = rotation.to_rotvec(rotation.multiply(lead.start.q_nb, rotation.conjugate(one.start.q_nb)))
        d = np.concatenate([lead.off - one.off, turn])
        J = np.eye(9)
        for axis, step in enumerate(1e-6 * np.eye(3)):
            both = rotation.multiply(rotation.from_rotvec(turn), rotation.from_rotvec(step))
            back = rotation.multiply(rotation.from_rotvec(turn), rotation.from_rotvec(-step))
            J[6:, 6 + axis] = (rotation.to_rotvec(both) - rotation.to_rotvec(back)) / 2e-6
        wanted += weight * (J @ one.cov @ J.T + np.outer(d, d))
        variance += weight * (np.array([0.5, 0.7]) ** 2 + (lead.extra - one.extra) ** 2)
    assert_allclose(found.cov[1], wanted, rtol=1e-4, atol=1e-4)
    assert_allclose(found.extra_sd[1] ** 2, variance, rtol=1e-6)
    assert_allclose(found.extra[1], lead.extra)


def test_a_heading_is_unknown_from_fifteen_degrees_on():
    start = sensors.sense(at_rest(3.0, 10.0, LLA), units(baro=None), 1, 0).initial
    for sd, unknown in ((14.9, False), (15.1, True)):
        cov = start.cov.copy()
        cov[8, 8] = np.deg2rad(sd) ** 2
        assert headings.heading_is_unknown(replace(start, cov=cov)) == unknown


def test_what_is_restored_names_one_of_the_hypotheses_and_a_time():
    filter_, _, made = begun(told)
    for best, good in ((0, True), (15, True), (16, False), (-1, False)):
        filter_.best, filter_.complete, filter_.members = best, True, list(made)
        for look in (filter_.check, filter_.make_parts):
            if good:
                look()
            else:
                with pytest.raises(ValueError, match=r"^best must be one of the hypotheses$"):
                    look()
        assert not good or filter_.members == [made[best]]
    filter_.best, filter_.span = 0, 0.0
    with pytest.raises(ValueError, match=r"^span must be positive$"):
        filter_.check()


def test_before_anything_is_told_the_heading_that_was_given_leads():
    """By a prior of 40 deg, or any heading alike; half way around is the first hypothesis."""
    for sd, weights in (
        (np.pi, np.ones(16)),
        (40 * DEG, np.exp(-0.5 * ((np.arange(16) - 8) / (16 / 9)) ** 2)),
    ):
        filter_, data, made = begun(lambda k, t: 2.0, sd)
        found = filter_.update(at(data, -1.0, 2.0), 0.5, last=False)
        assert_allclose(found.q_nb[0], made[8].start.q_nb)
        turns = [
            rotation.to_euler(one.start.q_nb)[2] - rotation.to_euler(made[0].start.q_nb)[2] for one in made
        ]
        assert_allclose(np.mod(turns, 2 * np.pi), np.arange(16) * np.pi / 8, atol=1e-6)
        w = weights / weights.sum()
        extra = np.arange(16) * 0.1
        assert found.extra_sd[0, 0] ** 2 == pytest.approx(0.25 + np.sum(w * (extra - 0.8) ** 2))


def test_one_stands_for_all_after_a_minute_and_what_may_still_come_late():
    """Of its innovations all are told then, and its events; the filters of the others are let go."""
    filter_, data, made = begun(told)
    filter_.update(at(data, -1.0, 50.0), 0.5, last=False)
    assert not filter_.complete
    found = [filter_.update(at(data, 50.0, 62.0), 0.5, last=False)]
    assert not filter_.complete  # half a second and two are left
    assert not found[0].events.rows()
    found.append(filter_.update(at(data, 62.0, 64.0), 0.5, last=False))
    assert filter_.complete
    assert filter_.members == [made[12]]
    sd = np.rad2deg(np.sqrt(made[12].cov[8, 8]))
    (settled,) = found[1].events.select("alignment")
    assert settled == (0.0, 60.0, f"heading unknown: 16 hypotheses; settled by 60 s, sd {sd:.2g} deg")
    assert {text.split()[0] for *_, text in found[1].events.select("note")} == {"12"}
    assert found[1].innovations.t.max() >= 60.0
    after = filter_.update(at(data, 64.0, np.inf), 0.5, last=True)
    assert after.t.tolist() == np.arange(65.0, 261.0, 5.0).tolist()
    assert_allclose(after.cov[0], made[12].cov)  # by itself


@pytest.mark.parametrize("settled", [60.0, 120.0])
def test_a_whole_record_in_one_piece_is_fed_to_all_hardly_further_than_they_are_needed(settled):
    filter_, data, made = begun(lambda k, t: told(k, t) if t > settled - 60.0 else 2.0)
    filter_.update(data, 0.0, last=True)
    assert filter_.members == [made[12]]
    assert made[12].end == 260.0
    assert {one.end for k, one in enumerate(made) if k != 12} <= set(np.arange(settled + 2.0, settled + 6.0))


def test_where_nothing_tells_it_is_asked_again_after_twice_as_long_until_the_end():
    filter_, data, _ = begun(lambda k, t: 2.0)
    filter_.update(at(data, -1.0, 150.0), 0.5, last=False)
    assert filter_.span == 240.0
    filter_.update(at(data, 150.0, 200.0), 0.5, last=False)
    found = filter_.update(at(data, 200.0, np.inf), 0.5, last=True)
    (said,) = found.events.select("alignment")
    assert said == (0.0, 260.0, "heading unknown: 16 hypotheses; no motion showed it")
    assert filter_.span == 480.0
    assert not filter_.complete
    assert found.t.tolist() == np.arange(205.0, 261.0, 5.0).tolist()


def test_innovations_are_those_of_the_one_that_leads_by_then():
    """The first 20 s the third is told, then the twelfth: it leads once it is twice as likely."""
    filter_, data, _ = begun(lambda k, t: 1.0 if k == (3 if t <= 20.0 else 12) else 2.0 + 0.01 * k)
    found = filter_.update(at(data, -1.0, 58.0), 0.5, last=False)
    by = found.innovations
    nis = {t: by.nis[(by.t == t) & (by.component == 0)].tolist() for t in (5.0, 20.0, 30.0, 50.0)}
    assert nis == {5.0: [1.0], 20.0: [1.0], 30.0: [2.03], 50.0: [1.0]}
    assert (np.diff(by.t) >= 0).all()
    leads = found.gyro_bias_b[:, 0]
    assert leads.tolist() == [8.0] + [3.0] * 8 + [12.0] * 3


def test_a_hypothesis_changes_only_for_one_more_than_twice_as_likely():
    weight = np.array(
        [[0.30, 0.2, 0.1, 0.45, 0.4], [0.61, 0.41, 0.19, 0.40, 0.2], [0.09, 0.39, 0.39, 0.15, 0.4]]
    )
    assert headings.leading(weight, 0).tolist() == [1, 1, 2, 0, 0]
    assert headings.leading(np.array([[0.5], [1.0]]), 0).tolist() == [0]


def test_what_an_innovation_tells_of_a_heading():
    """NIS once for its measurement, at most 30; variances of all components; nothing by what is assumed."""
    rows = [
        (1.0, 0, 0, 0.0, 4.0, 7.0, True),
        (1.0, 0, 1, 0.0, 9.0, 7.0, True),
        (1.0, 1, 0, 0.0, 1.0, 99.0, False),
        (1.0, 3, 0, 0.0, 4.0, 7.0, True),
        (2.0, 0, 0, 0.0, 4.0, 7.0, True),
        (2.0, 4, 0, 0.0, 4.0, 7.0, True),
        (2.0, 4, 0, 0.0, np.nan, 7.0, True),
    ]
    rest = np.array([False] * 4 + [True] * 3)
    found = headings.gains(Innovations.from_rows(NAMES, rows), rest, ["magnetometer"])
    one = -3.5 - 0.5 * np.log(4.0)
    assert_allclose(found, [one, -0.5 * np.log(9.0), -15.0, 0.0, 0.0, one, -np.inf])


def test_the_spread_of_headings_is_that_about_the_best():
    class Member:
        def __init__(self, turn):
            self.q_nb = rotation.from_euler(0.0, 0.0, np.array([9.0, turn]))
            self.cov = np.zeros((2, 9, 9))
            self.cov[:, 8, 8] = 9.0, turn**2

    weight = np.array([[1.0, 0.2], [0.0, 0.5], [0.0, 0.3]])
    spread, own = headings.heading_spread([Member(turn) for turn in (0.1, 0.4, 0.9)], weight, 1)
    assert spread == pytest.approx(np.sqrt(0.2 * 0.09 + 0.3 * 0.25))
    assert own == pytest.approx(0.4)


def test_gyros_that_gyrocompass_may_tell_a_heading_at_rest():
    """Where the rate of the Earth is seen every sensor counts at rest, else the magnetometer alone."""
    for sd, count in ((0.9, 2), (1.1, 1)):
        rate = earth.EARTH_RATE * np.cos(0.8) * np.pi / np.sqrt(3.0)
        truth = at_rest(3.0, 1.0, LLA)
        imu = ImuSpec("unit", TriadSpec(turn_on_bias_sd=sd * rate), TriadSpec())
        spec = replace(units(imu, baro=None), output_rate=1.0)
        sensed = sensors.sense(truth, spec, 1, 0)
        made = headings.ManyHeadings(lambda *_: None, sensed.data, sensed.initial, [])
        assert ("gnss_position" in made.by_rest, "magnetometer" in made.by_rest) == (count == 2, True)


def test_another_heading_takes_place_and_velocity_along_and_leaves_what_it_does_not_explain():
    cov, by_heading = np.diag(np.arange(1.0, 10.0) * 1e-4), np.zeros(9)
    by_heading[[0, 1, 2, 3, 4, 5]] = 30.0, -20.0, 10.0, 2.0, -3.0, 0.5
    by_heading[8] = 1.0
    cov[8, 8] = 0.0
    cov += 0.04 * np.outer(by_heading, by_heading)
    bias_cov = np.arange(54.0).reshape(9, 6)
    start = InitialState(
        0.0, LLA, np.array([20.0, 15.0, 1.0]), rotation.from_euler(0.0, 0.0, 1.0), cov, "given"
    )
    turned = headings.turn_heading(replace(start, bias_cov=bias_cov), 0.4)
    assert_allclose(earth.difference_n(turned.lla, LLA), 0.4 * by_heading[:3], atol=1e-3)
    assert_allclose(turned.vel_n, start.vel_n + 0.4 * by_heading[3:6])
    assert_allclose(np.diag(turned.cov)[:6], np.arange(1.0, 7.0) * 1e-4 + (headings.SD * by_heading[:6]) ** 2)
    assert turned.cov[8, 8] == pytest.approx((np.pi / 16) ** 2)
    left = bias_cov - np.outer(by_heading, bias_cov[8])
    left[6:8] = [[np.cos(0.4), -np.sin(0.4)], [np.sin(0.4), np.cos(0.4)]] @ left[6:8]
    assert_allclose(turned.bias_cov, left, atol=1e-9)


def test_the_weights_of_an_answer_do_not_depend_on_the_others():
    log = 5.0 * np.random.default_rng(11).standard_normal((headings.COUNT, 50))
    together = headings.shares(log)
    alone = np.hstack([headings.shares(log[:, k : k + 1]) for k in range(50)])
    np.testing.assert_array_equal(alone, together)
    assert_allclose(together.sum(axis=0), 1.0, rtol=1e-14)
