"""The rules of the search for a mistaken convention, each on both sides of its limits, on made errors."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose

from bench.core.mathematics import earth
from bench.evaluation.consistency.block_nees import BlockNees
from bench.evaluation.conventions import convention_search
from bench.evaluation.conventions.convention_search import Mistake
from bench.evaluation.conventions.known_conventions import Answers, Convention, list_conventions
from tests.synthetic import turning

TRUTH = turning(10.0, 100.0)
ROWS = np.arange(100, 900, 20)


def made(error_n, variance=1.0) -> Answers:
    """The truth, each position off by an error (M, 3) [m], n, and variances of 1 for every state."""
    lla = earth.displace(TRUTH.lla[ROWS], np.broadcast_to(error_n, (len(ROWS), 3)))
    cov = np.eye(9) * np.broadcast_to(variance, (len(ROWS), 9))[:, :, None]
    return Answers(TRUTH.t[ROWS], lla, TRUTH.vel_n[ROWS], TRUTH.q_nb[ROWS], cov)


def nees(mean: float, low: float = 0.5, high: float = 9.0, samples: float = 10.0) -> BlockNees:
    return BlockNees(3, mean, low, high, samples)


def ask(answers: Answers, one: Convention) -> Mistake | None:
    own = convention_search.judge(TRUTH, answers, ["pos", "vel"])
    return convention_search.try_convention(TRUTH, answers, one, ["pos"], ["pos", "vel"], own["pos"])


@pytest.mark.parametrize(
    ("before", "after", "named"),
    [
        (27.0, 2.0, True),  # one value: 25 of chi-square, which is 23.9 by chance in 1 of a million
        (25.0, 2.0, False),
        (300.0, 29.0, True),  # outside its band, 16.3, and yet down tenfold
        (300.0, 31.0, False),
    ],
)
def test_what_is_undone_must_fit_or_be_down_tenfold_and_more_than_by_chance(before, after, named):
    """An error that lasts the run is one value, of so many sigmas as the root of its NEES."""
    better = made([np.sqrt(after), 0.0, 0.0])
    one = Convention("made", lambda _: "made", ("pos",), lambda *_: better)
    found = ask(made([np.sqrt(before), 0.0, 0.0]), one)
    assert (found is not None) == named
    if found is not None:
        assert (found.before.mean, found.after.mean) == pytest.approx((before, after))
        assert set(found.left) == {"pos", "vel", "all"}
        assert found.left["all"].mean == pytest.approx(after)


@pytest.mark.parametrize(
    ("sizes", "narrower", "named"),
    [
        ((0.26, 0.26, 1.69), (1.0, 10.0, 100.0), True),
        ((0.24, 0.26, 1.69), (1.0, 10.0, 100.0), False),
        ((3.9, 0.8, 0.8), (100.0, 10.0, 1.0), True),
        ((4.02, 0.3, 0.3), (100.0, 10.0, 1.0), False),
        ((0.26, 0.26, 1.69), (10.0, 10.0, 10.0), False),  # overconfident by a factor fits as well
        ((1.0, 1.0, 1.0), (1.1, 1.1, 1.1), False),  # the covariance as it is given does, too
    ],
)
def test_a_wider_claim_has_to_fit_every_state_and_be_no_factor(sizes, narrower, named):
    given = made(sizes, np.tile(np.array(narrower) ** -2.0, 3))
    one = Convention("made", lambda _: "made", ("pos",), lambda *_: made(sizes), of_claim=True)
    assert (ask(given, one) is not None) == named


@pytest.mark.parametrize(
    ("size", "both", "named"),
    [(0.9, True, False), (1.1, True, True), (1.1, False, False), (5.9, True, True), (6.1, True, False)],
)
def test_a_constant_is_named_between_its_sizes_if_both_halves_have_it(monkeypatch, size, both, named):
    monkeypatch.setattr(convention_search, "fit", lambda *_: (np.array([0.6, -0.8]) * size, both))
    one = Convention(
        "made", lambda _: "made", ("pos",), lambda *_: made(0.0), lambda motion: None, 2, least=1.0, most=6.0
    )
    assert (ask(made([30.0, 0.0, 0.0]), one) is not None) == named


def test_constants_are_a_weighted_mean_and_each_half_has_its_own():
    """10 m too low and 20 m too low, with variances of 1 and 4: 12 m, and 10 and 20 in the halves."""
    (height,) = (one for one in list_conventions(np.zeros(3)) if one.name == "height")
    late = np.arange(len(ROWS)) >= len(ROWS) // 2
    error = np.outer(np.where(late, 20.0, 10.0), [0.0, 0.0, 1.0])
    answers = made(error, np.where(late, 4.0, 1.0)[:, None])
    whole, halves = convention_search.solve(TRUTH, answers, height, ["pos"], np.zeros(1))
    assert_allclose(whole, [12.0], atol=1e-6)
    assert_allclose(halves, [[10.0], [20.0]], atol=1e-6)
    after, _ = convention_search.solve(TRUTH, answers, height, ["pos"], np.array([5.0]))
    assert_allclose(after, [7.0], atol=1e-6)
    flat = replace(answers, cov=0.0 * answers.cov)
    assert convention_search.solve(TRUTH, flat, height, ["pos"], np.zeros(1)) == (None, [])


def test_a_fit_begins_where_the_errors_are_least(monkeypatch):
    """Of a constant with several starts the best is taken, by every so manieth time."""
    seen = []

    def solve(truth, answers, one, blocks, constants):
        seen.append(constants.copy())
        return np.zeros(1), [np.zeros(1)] * 2

    monkeypatch.setattr(convention_search, "solve", solve)
    (height,) = (one for one in list_conventions(np.zeros(3)) if one.name == "height")
    one = replace(height, starts=(-20.0, 0.0, 7.0, 30.0))
    constants, same = convention_search.fit(TRUTH, made([0.0, 0.0, 9.0]), one, ["pos"])
    assert (constants.tolist(), same) == ([7.0], True)
    assert seen[0].tolist() == [7.0]


def mistake(
    name: str, mean: float, *, of_claim=False, alone=True, constants=0, block="pos", left=None
) -> Mistake:
    one = Convention(name, lambda _: name, (block,), None, None, constants, of_claim=of_claim, alone=alone)
    left = {"pos": nees(mean), "vel": nees(1.0), "all": nees(mean)} | (left or {})
    return Mistake(one, np.empty(0), None, nees(500.0), nees(mean, samples=1000.0), left)


@pytest.mark.parametrize(
    ("samples", "mean", "alike"),
    [(1000.0, 3.59, True), (1000.0, 3.61, False), (10.0, 4.07, True), (10.0, 4.09, False), (0.2, 13.7, True)],
)
def test_two_fit_alike_within_a_fifth_or_what_one_freedom_allows(samples, mean, alike):
    best = replace(mistake("a", 3.0), after=nees(3.0, samples=samples))
    assert convention_search.is_alike(best, mistake("b", mean)) == alike


def test_blocks_that_neither_changes_do_not_count():
    best = mistake("a", 3.0, left={"vel": nees(1.0), "all": nees(0.0)})
    assert convention_search.is_alike(best, mistake("b", 3.0, left={"vel": nees(99.0), "all": nees(99.0)}))
    assert not convention_search.is_alike(best, mistake("b", 3.0, block="vel", left={"vel": nees(99.0)}))


@pytest.mark.parametrize(
    ("found", "named"),
    [
        ([("a", 3.0, {}), ("b", 2.0, {})], ["b"]),  # the least
        ([("a", 2.2, {"constants": 3}), ("b", 2.0, {"constants": 1})], ["b", "a"]),  # the simplest first
        ([("a", 2.0, {"alone": False}), ("b", 2.1, {})], ["b", "a"]),
        ([("a", 2.0, {"alone": False}), ("b", 3.0, {})], []),  # it is not named without another
        ([("a", 20.0, {}), ("b", 3.0, {"of_claim": True})], ["a"]),  # answers, though they leave something
        ([("a", 8.0, {}), ("c", 20.0, {}), ("b", 3.0, {"of_claim": True})], ["a"]),
        ([("b", 3.0, {"of_claim": True})], ["b"]),
        ([("a", 20.0, {}), ("b", 30.0, {})], ["a"]),
        ([], []),
    ],
)  # fmt: skip
def test_answers_come_before_a_claim(monkeypatch, found, named):
    mistakes = {name: mistake(name, mean, **more) for name, mean, more in found}
    monkeypatch.setattr(convention_search, "try_convention", lambda *given: mistakes[given[2].name])
    conventions = [one.convention for one in mistakes.values()]
    best = convention_search.search(TRUTH, made([99.0, 0.0, 0.0]), ["pos", "vel"], conventions)
    assert [one.convention.name for one in best] == named


def test_a_convention_is_tried_if_a_block_that_it_changes_is_off(monkeypatch):
    tried = []
    monkeypatch.setattr(convention_search, "try_convention", lambda *given: tried.append(given[2:4]))
    conventions = [
        Convention(name, None, blocks, None, of_claim=of_claim)
        for name, blocks, of_claim in (
            ("off", ("pos", "vel"), False),
            ("sound", ("vel",), False),
            ("claim", ("vel",), True),
            ("not reported", ("phi",), True),
        )
    ]
    convention_search.search(TRUTH, made([99.0, 0.0, 0.0]), ["pos", "vel"], conventions)
    assert [(one.name, off) for one, off in tried] == [("off", ["pos", "vel"]), ("claim", ["vel"])]


def test_what_holds_is_neither_too_large_nor_too_small():
    assert convention_search.is_consistent({"pos": nees(3.0), "all": nees(3.0)})
    assert not convention_search.is_consistent({"pos": nees(3.0), "all": nees(9.1)})
    assert not convention_search.is_consistent({"pos": nees(9.1), "all": nees(3.0)})
    assert not convention_search.is_consistent({"pos": nees(0.4), "all": nees(3.0)})


def test_the_sentence_names_steps_and_what_is_not_told():
    a, b, c = (mistake(name, 2.0) for name in "abc")
    whole = BlockNees(9, 8.5, 1.0, 20.0, 10.0)
    told = convention_search.describe([[a, b, c], [b]], BlockNees(9, np.inf, 0.0, np.inf, 0.0), whole)
    assert told == (
        "Looks like a, b or c (this flight does not show which), and b: without these its NEES is 8.5 and "
        "not without bound (9 expected)."
    )
    told = convention_search.describe([[a]], BlockNees(9, 1234.0, 0.0, 1.0, 0.0), whole)
    assert told == "Looks like a: without that its NEES is 8.5 and not 1230 (9 expected)."
    assert convention_search.keep_finite(np.inf) is None
    assert convention_search.keep_finite(2.0) == 2.0
