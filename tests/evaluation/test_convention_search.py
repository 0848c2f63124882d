"""The rules of the search for a mistaken convention, each on both sides of its limits, on made errors."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose

from bench.core.mathematics import earth
from bench.evaluation.consistency.block_nees import BlockNees
from bench.evaluation.conventions import convention_search, null_model
from bench.evaluation.conventions.convention_search import Mistake
from bench.evaluation.conventions.known_conventions import Answers, Convention, TrueMotion, list_conventions
from tests.synthetic import turning

TRUTH = turning(10.0, 100.0)
ROWS = np.arange(100, 900, 20)


def made(error_n, variance=1.0) -> Answers:
    """The truth, each position off by an error (M, 3) [m], n, and variances of 1 for every state."""
    lla = earth.displace(TRUTH.lla[ROWS], np.broadcast_to(error_n, (len(ROWS), 3)))
    cov = np.eye(9) * np.broadcast_to(variance, (len(ROWS), 9))[:, :, None]
    first = np.zeros(len(ROWS), np.int64)
    return Answers(TRUTH.t[ROWS], lla, TRUTH.vel_n[ROWS], TRUTH.q_nb[ROWS], cov, first)


def nees(mean: float, low: float = 0.5, high: float = 9.0, samples: float = 10.0) -> BlockNees:
    return BlockNees(3, mean, low, high, samples)


def ask(answers: Answers, one: Convention) -> Mistake | None:
    return convention_search.try_convention([TRUTH], answers, one, ["pos"], ["pos", "vel"])


LIMIT = convention_search._BEYOND


@pytest.mark.parametrize(
    ("before", "after", "named"),
    [
        (LIMIT + 3.0, 2.0, True),  # an error that lasts is one value, of so many sigmas as the root of it
        (LIMIT + 1.0, 2.0, False),
        (300.0, 29.0, True),  # outside its band, 16.3, and yet down tenfold
        (300.0, 31.0, False),
    ],
)
def test_what_is_undone_must_fit_or_be_down_tenfold_and_beyond_the_null(before, after, named):
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
    """The sizes of errors are constant, so that their NEES is one value, and their signs are drawn."""
    error = np.random.default_rng(3).choice([-1.0, 1.0], (len(ROWS), 3)) * sizes
    given = made(error, np.tile(np.array(narrower) ** -2.0, 3))
    one = Convention("made", lambda _: "made", ("pos",), lambda *_: made(error), of_claim=True)
    assert (ask(given, one) is not None) == named


@pytest.mark.parametrize(
    ("size", "named"), [(0.9, False), (1.1, True), (5.9, True), (6.1, False), (np.nan, False)]
)
def test_a_constant_is_named_between_its_sizes(monkeypatch, size, named):
    monkeypatch.setattr(convention_search, "fit", lambda *_: np.array([0.6, -0.8]) * size)
    one = Convention(
        "made", lambda _: "made", ("pos",), lambda *_: made(0.0), lambda motion: None, 2, least=1.0, most=6.0
    )
    assert (ask(made([30.0, 0.0, 0.0]), one) is not None) == named


def test_constants_are_a_weighted_mean():
    """10 m too low and 20 m too low, with variances of 1 and 4: 12 m."""
    (height,) = (one for one in list_conventions(np.zeros(3)) if one.name == "height")
    late = np.arange(len(ROWS)) >= len(ROWS) // 2
    error = np.outer(np.where(late, 20.0, 10.0), [0.0, 0.0, 1.0])
    answers = made(error, np.where(late, 4.0, 1.0)[:, None])

    def solve(given, start, white):
        return convention_search.solve([TRUTH], given, height, ["pos"], np.array([start]), white)

    assert_allclose(solve(answers, 0.0, True), [12.0], atol=1e-6)
    assert_allclose(solve(answers, 5.0, True), [7.0], atol=1e-6)
    assert np.isnan(solve(replace(answers, cov=0.0 * answers.cov), 0.0, True)).all()
    assert np.isnan(solve(replace(answers, cov=0.0 * answers.cov), 0.0, False)).all()


def test_constants_of_errors_that_wander_are_those_of_their_start():
    """Of a height that is 5 m too low and then walks, the mean of the run is far off, not the first one."""
    (height,) = (one for one in list_conventions(np.zeros(3)) if one.name == "height")
    walk = np.cumsum(np.random.default_rng(9).normal(1.0, 1.0, len(ROWS)))
    answers = made(np.outer(5.0 + walk, [0.0, 0.0, 1.0]))
    white, weighted = (
        convention_search.solve([TRUTH], answers, height, ["pos"], np.zeros(1), one)[0]
        for one in (True, False)
    )
    assert white > 20.0
    assert abs(weighted - 5.0) < 4.0


def test_a_fit_begins_where_the_errors_are_least(monkeypatch):
    """Of a constant with several starts the best is taken, by every so manieth time."""
    seen = []

    def solve(truths, answers, one, blocks, constants, white):
        seen.append((constants.tolist(), white))
        return np.zeros(1)

    monkeypatch.setattr(convention_search, "solve", solve)
    (height,) = (one for one in list_conventions(np.zeros(3)) if one.name == "height")
    one = replace(height, starts=(-20.0, 0.0, 7.0, 30.0))
    constants = convention_search.fit([TRUTH], made([0.0, 0.0, 9.0]), one, ["pos"])
    assert constants.tolist() == [7.0]
    assert seen[:3] == [([7.0], True), ([7.0], True), ([7.0], False)]


def mistake(
    name: str, mean: float, beyond: float = 0.0, *, of_claim=False, alone=True, constants=0
) -> Mistake:
    one = Convention(name, lambda _: name, ("pos",), None, None, constants, of_claim=of_claim, alone=alone)
    left = {"pos": nees(mean), "vel": nees(1.0), "all": nees(mean)}
    return Mistake(one, np.empty(0), None, nees(500.0), nees(mean, samples=1000.0), left, beyond)


NEAR = convention_search._ALIKE


@pytest.mark.parametrize(
    ("found", "named"),
    [
        ([("a", 2.0, 90.0, {}), ("b", 3.0, 99.0 + NEAR, {})], ["b"]),  # the likeliest
        ([("a", 2.0, 99.0, {}), ("b", 3.0, 99.0 + 0.99 * NEAR, {})], ["a", "b"]),
        ([("a", 2.0, 99.0, {"constants": 3}), ("b", 2.0, 98.0, {"constants": 1})], ["b", "a"]),
        ([("a", 2.0, 99.0, {"alone": False}), ("b", 2.0, 98.0, {})], ["b", "a"]),
        ([("a", 2.0, 99.0, {"alone": False}), ("b", 2.0, 50.0, {})], []),  # it is not named without another
        ([("a", 20.0, 50.0, {}), ("b", 3.0, 99.0, {"of_claim": True})], ["a"]),  # answers before a claim
        ([("a", 8.0, 50.0, {}), ("c", 20.0, 99.0, {}), ("b", 3.0, 99.0, {"of_claim": True})], ["a"]),
        ([("b", 3.0, 99.0, {"of_claim": True})], ["b"]),
        ([("a", 20.0, 99.0, {}), ("b", 30.0, 50.0, {})], ["a"]),
        ([], []),
    ],
)
def test_the_likeliest_is_named_with_those_that_are_nearly_as_likely(monkeypatch, found, named):
    mistakes = {name: mistake(name, mean, beyond, **more) for name, mean, beyond, more in found}
    monkeypatch.setattr(convention_search, "try_convention", lambda *given: mistakes[given[2].name])
    conventions = [one.convention for one in mistakes.values()]
    best = convention_search.search([TRUTH], made([99.0, 0.0, 0.0]), ["pos", "vel"], conventions)
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
    convention_search.search([TRUTH], made([99.0, 0.0, 0.0]), ["pos", "vel"], conventions)
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
        "Looks like a, b or c (this motion cannot distinguish them), and b: without these its NEES is 8.5 "
        "and not without bound (9 expected)."
    )
    told = convention_search.describe([[a]], BlockNees(9, 1234.0, 0.0, 1.0, 0.0), whole)
    assert told == "Looks like a: without that its NEES is 8.5 and not 1230 (9 expected)."
    assert convention_search.keep_finite(np.inf) is None
    assert convention_search.keep_finite(2.0) == 2.0


# --- the null: a covariance that is wrong by a factor, and errors that wander -----------------------------

T = np.arange(1.0, 401.0)
MOTION = TrueMotion(
    np.ones(400, bool), *(np.zeros((400, n)) for n in (3, 3, 4, 3, 3, 3)), np.ones(400), T == 1.0
)  # fmt: skip


def find_log_likelihood(z, time, walk, scale) -> float:
    """-2 log likelihood, without the constant term, by the whole covariance matrix of the series."""
    apart = np.abs(np.subtract.outer(T, T))
    kept = np.exp(-apart / time) if time else np.eye(len(T))
    cov = scale * (kept + walk**2 * np.minimum.outer(T, T))
    return float(np.linalg.slogdet(cov)[1] + z @ np.linalg.solve(cov, z))


@pytest.mark.parametrize(("time", "walk"), [(0.0, 0.0), (30.0, 0.0), (0.0, 0.1), (10.0, 0.0316)])
def test_the_likelihood_is_that_of_the_covariance_matrix_of_the_series(time, walk):
    z = np.random.default_rng(5).normal(size=400)
    v, logs = null_model.innovate(z[:, None], MOTION, time, walk)
    expected = find_log_likelihood(z, time, walk, 1.0)
    assert float(v[:, 0] @ v[:, 0]) + logs == pytest.approx(expected, rel=1e-9)


def test_the_factor_correlation_and_walk_are_those_of_the_series():
    r = np.random.default_rng(6)
    markov = np.empty((400, 3))
    markov[0] = r.normal(size=3)
    for k in range(1, 400):
        markov[k] = np.exp(-1.0 / 10.0) * markov[k - 1] + np.sqrt(1.0 - np.exp(-0.2)) * r.normal(size=3)
    noise = null_model.fit_noise(4.0 * markov, MOTION, 0.0)
    assert noise.scale == pytest.approx(16.0, rel=0.5)
    assert {time for time, _ in noise.chosen} <= {3.0, 10.0, 30.0}
    walks = np.cumsum(r.normal(size=(400, 3)), axis=0)
    wandering = null_model.fit_noise(r.normal(size=(400, 3)) + walks, MOTION, 0.0)
    assert all(0.5 < walk * np.sqrt(wandering.scale) < 2.0 for _, walk in wandering.chosen)
    assert null_model.fit_noise(0.1 * markov, MOTION, 1.0).scale == 1.0
    assert null_model.fit_noise(4.0 * markov, MOTION, 1.0, 1.0).scale == 1.0


def test_a_series_begins_anew_with_each_run():
    z = np.random.default_rng(7).normal(size=(200, 1))
    one = replace(MOTION, dt=np.ones(200), first=T[:200] == 1.0)
    two = replace(MOTION, first=(T == 1.0) | (T == 201.0))
    v, logs = null_model.innovate(np.vstack([z, z]), two, 30.0, 0.1)
    alone, half = null_model.innovate(z, one, 30.0, 0.1)
    assert_allclose(v, np.vstack([alone, alone]))
    assert logs == pytest.approx(2.0 * half)


def test_errors_without_a_covariance_have_no_likelihood():
    assert null_model.find_misfit(np.ones((400, 3)), np.zeros((400, 3, 3)), MOTION, 1.0) == np.inf
    cov = np.tile(np.eye(3), (400, 1, 1))
    assert null_model.find_misfit(np.full((400, 3), np.nan), cov, MOTION, 1.0) == np.inf


def test_what_is_whitened_has_the_covariance_of_one():
    cov = np.array([[4.0, 1.0, 0.0], [1.0, 9.0, 0.0], [0.0, 0.0, 1e-8]])
    L = np.linalg.cholesky(cov)
    white, volume = null_model.whiten(np.tile(L, (2, 1, 1)), np.tile(cov, (2, 1, 1)))
    assert_allclose(white, np.tile(np.eye(3), (2, 1, 1)), atol=1e-12)
    assert volume == pytest.approx(2.0 * np.log(np.linalg.det(cov)))
