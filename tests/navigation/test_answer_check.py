"""What a filter answers is checked once: what is wrong is named, what is sound keeps every bit."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from bench.core.records.data import Events, NavSolution
from bench.core.words.exceptions import EstimatorFailedError
from bench.navigation.answer_check import LARGEST, check_solution
from bench.navigation.built_in import load
from bench.navigation.estimator import accept, find_same
from tests.builders import assert_same_solution
from tests.fuzz_answers import force
from tests.weaving import units

FLIGHT, UNITS = (4.0,), units()


@pytest.fixture(scope="module")
def sound(sensed):
    return load("loose-15", {}).run(sensed.data, sensed.initial)


def put(column, where, value):
    changed = np.array(column)
    changed[where] = value
    return changed


WRONG = {
    "events must be Events; got list": lambda x: force(x, events=[]),
    "innovations must be Innovations; got NoneType": lambda x: force(x, innovations=None),
    "extra_names must be a tuple of texts; got str": lambda x: force(x, extra_names="ab"),
    "extra_names[0] must be a text; got int": lambda x: force(x, extra_names=(5,)),
    "extra_names[0] = 'a\\ud800' contains an invalid character": lambda x: force(x, extra_names=("a\ud800",)),
    "events.kind[0] must be a text; got int": lambda x: force(
        x, events=Events(np.zeros(1), np.zeros(1), (5,), ("",), ("",))
    ),
    "NavSolution.vel_n must have shape (N, 3); got (5, 2)": lambda x: force(x, vel_n=np.zeros((5, 2))),
    "NavSolution.lla is 1e+300 in row 0; up to 1e+150": lambda x: replace(x, lla=put(x.lla, (0, 2), 1e300)),
    "its latitude is 100 deg at t = 0.2 s; lla is": lambda x: replace(
        x, lla=put(x.lla, (2, 0), np.radians(100.0))
    ),
    "cov is not symmetric at t = 0.1 s: pos_n with pos_e 100, pos_e with pos_n": lambda x: replace(
        x, cov=put(x.cov, (1, 0, 1), 100.0)
    ),
    "innovations.code is 99; it is an index into the": lambda x: replace(
        x, innovations=replace(x.innovations, code=put(x.innovations.code, 0, 99))
    ),
    "extra_names has 'a' twice": lambda x: replace(
        x, extra_names=("a", "a"), extra=np.ones((len(x), 2)), extra_sd=np.ones((len(x), 2))
    ),
    "run() must return a NavSolution; got dict": lambda x: {},
}


@pytest.mark.parametrize("words", WRONG)
def test_what_is_wrong_with_an_answer_is_named(sound, words):
    with pytest.raises(EstimatorFailedError) as error:
        accept("mine", WRONG[words](sound))
    assert str(error.value).startswith(f"filter 'mine': {words}")


def test_what_the_contract_allows_keeps_its_bits(sensed, sound):
    """Blocks that are NaN, infinite variances, a solution that diverges, and float32."""
    nan, cov = np.full_like(sound.vel_n, np.nan), np.array(sound.cov)
    cov[:, 3:6], cov[:, :, 3:6], cov[:3, 0, 0] = np.nan, np.nan, np.inf
    far = put(sound.lla, (slice(None), 2), 0.9 * LARGEST)
    for one in (
        sound,
        replace(sound, vel_n=nan, cov=cov),
        replace(sound, lla=far),
        replace(sound, lla=put(sound.lla, 3, np.inf)),
        replace(sound, cov=sound.cov.astype(np.float32)),
        load("classic-22", {"covariance_precision": "single"}).run(sensed.data, sensed.initial),
    ):
        assert_same_solution(check_solution(one), one)


def test_triangles_that_nearly_agree_get_their_mean(sound):
    size = np.sqrt(sound.cov[4, 0, 0] * sound.cov[4, 7, 7])
    cov = put(sound.cov, (4, 0, 7), sound.cov[4, 0, 7] + 0.9e-5 * size)
    found = check_solution(replace(sound, cov=cov)).cov
    assert (found == found.transpose(0, 2, 1)).all()
    assert found[4, 0, 7] == 0.5 * (cov[4, 0, 7] + cov[4, 7, 0])
    with pytest.raises(ValueError, match="not symmetric"):
        check_solution(replace(sound, cov=put(cov, (4, 0, 7), sound.cov[4, 0, 7] + 1.1e-5 * size)))


def test_a_class_of_ones_own_comes_back_as_a_solution(sound):
    class Own(NavSolution):
        __slots__ = ()

    own = force(object.__new__(Own), **{name: getattr(sound, name) for name in sound.__dataclass_fields__})
    assert type(check_solution(own)) is NavSolution


def test_an_identity_that_raises_is_none():
    class Odd:
        def identity(self, sensors):
            return []  # no key of a table

    assert find_same({"a": Odd(), "b": Odd()}, None) == {}
