"""Consistency of a filter over many runs: the rule of the verdict, and its sentences.

The errors of a filter may last a whole run: a turn-on bias does. Epochs of one run are then far from
independent, so every test here takes the run as the sample, or one time of every run:

(a) the run averages of NEES against its number of states n, by Student's t;
(b) NEES averaged over the N runs (ANEES) at a few epochs declared beforehand. N ANEES is chi-square with
    n N degrees of freedom there, whatever the correlation in time;
(c) the mean NIS of each sensor. Innovations of a matched filter are independent in time.

Source: Bar-Shalom, Li, Kirubarajan, Estimation with Applications to Tracking and Navigation, 5.4.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from bench.core.mathematics.arrays import FloatArray, IntArray, as_float
from bench.evaluation.consistency.chi_square import NIS_PROBABILITY, MeanNis, SensorNis, mean_band, mean_nis

LEAST_RUNS = 40
"""Fewest runs that are evaluated; fewer leave the interval of ANEES wider than `TOLERATED`."""

INSTANTS = 6
"""Number of epochs of test (b), evenly spaced from the first to the last epoch."""

ERROR_RATE = 0.005
"""False-alarm rate of test (a), and of test (b) over all its epochs [1]."""

TOLERATED = (0.8, 1.25)
"""Range of ANEES / n in which a filter is called consistent: P is right within 25 % [1]."""

Word = Literal["consistent", "overconfident", "underconfident", "undecided"]


@dataclass(frozen=True, slots=True)
class Consistency:
    """Consistency of a filter over runs: the verdict, its interval, and the tests."""

    states: int  # n, the expected NEES
    runs: int
    mean: float  # of NEES over all runs and epochs
    ratio: float  # ANEES / n: 1 is expected
    low: float  # interval of the ratio, with probability 1 - ERROR_RATE
    high: float
    word: Word
    runs_to_decide: int | None  # number of runs that would decide, if the word is "undecided"
    instants: IntArray  # (K,) epochs of test (b)
    anees: FloatArray  # (K,) NEES averaged over the runs there
    band: tuple[float, float]  # of each of them
    nis: Mapping[str, MeanNis]  # by sensor
    reasons: tuple[str, ...]  # one for each test that fails

    @property
    def rejected(self) -> bool:
        """Return whether a test fails, that is, whether the covariance does not match the errors exactly."""
        return bool(self.reasons)

    @property
    def sentence(self) -> str:
        """The verdict with the numbers that support it."""
        text = (
            f"{self.word}: ANEES / {self.states} is {self.ratio:.2f}, {self.low:.2f} to {self.high:.2f} "
            f"from {self.runs} runs"
        )
        if self.runs_to_decide is not None:
            text += f"; about {self.runs_to_decide} runs would decide"
        return text


def check_consistency(
    nees: FloatArray,
    states: int,
    nis: Mapping[str, Sequence[SensorNis] | MeanNis],
    instants: Sequence[int] | None = None,
) -> Consistency:
    """Evaluate from many runs whether the covariance of a filter describes its errors.

    The filter is *rejected* if one of the tests (a), (b), (c) of this module fails. A matched filter is
    rejected in less than 2 % of all cases, also if its errors last the whole run. With many runs the tests
    find errors of P that do not matter, so the *word* comes from the size of the error: the interval of
    ANEES / n is wholly inside `TOLERATED` (consistent), wholly outside (over- or underconfident), or neither
    (undecided).

    Parameters
    ----------
    nees : (R, M) array
        NEES of R runs with independent noise, at M common epochs after the alignment window.
    states : int
        Number of states in NEES, n.
    nis : mapping of sequences of SensorNis, or of MeanNis
        By sensor, one entry per run (`bench.evaluation.consistency.chi_square.nis_by_sensor`), or their mean.
    instants : sequence of int or None
        Epochs of test (b), chosen before the data is seen; None spaces `INSTANTS` of them evenly.

    Raises
    ------
    ValueError
        If there are fewer than `LEAST_RUNS` runs, no epochs, or no updates of a sensor.
    """
    from scipy.special import stdtrit

    nees = as_float("nees", nees, (None, None), finite=False)
    runs, epochs = nees.shape
    if runs < LEAST_RUNS or epochs < 1:
        raise ValueError(f"nees must hold at least {LEAST_RUNS} runs and 1 epoch; got {runs} and {epochs}")
    if instants is None:
        instants = np.unique(np.linspace(0, epochs - 1, INSTANTS).astype(np.int64)).tolist()
    at = np.asarray(instants, np.int64)
    averages = nees.mean(axis=1)
    mean = float(averages.mean())
    reach = float(stdtrit(runs - 1, 1.0 - 0.5 * ERROR_RATE) * averages.std(ddof=1) / np.sqrt(runs))
    anees = nees[:, at].mean(axis=0)
    band = mean_band(states, runs, 1.0 - ERROR_RATE / len(at))
    sensors = {
        name: series
        if isinstance(series, MeanNis)
        else mean_nis(np.concatenate([s.nis for s in series]), np.concatenate([s.dof for s in series]))
        for name, series in nis.items()
    }
    reasons = []
    if not abs(mean - states) <= reach:
        reasons.append(
            f"mean NEES {mean:.3f} differs from {states} by more than {reach:.3f}, the {1 - ERROR_RATE:.1%} "
            f"interval of {runs} run averages"
        )
    outside = int(np.sum(~((band[0] <= anees) & (anees <= band[1]))))
    if outside:
        reasons.append(
            f"NEES over {runs} runs is outside {band[0]:.2f} to {band[1]:.2f} at {outside} of {len(at)} "
            f"epochs: {', '.join(f'{value:.2f}' for value in anees)}"
        )
    reasons += [
        f"mean NIS of {name} is {s.mean:.4f} over {s.updates} updates; its {NIS_PROBABILITY:.1%} band is "
        f"{s.low:.4f} to {s.high:.4f}"
        for name, s in sensors.items()
        if not s.inside
    ]
    ratio, half = mean / states, reach / states
    word, needed = _choose_word(ratio, half, runs)
    return Consistency(
        states=states,
        runs=runs,
        mean=mean,
        ratio=ratio,
        low=ratio - half,
        high=ratio + half,
        word=word,
        runs_to_decide=needed,
        instants=at,
        anees=anees,
        band=band,
        nis=sensors,
        reasons=tuple(reasons),
    )


def _choose_word(ratio: float, half: float, runs: int) -> tuple[Word, int | None]:
    """Return the verdict for the interval ratio +- half, and the number of runs that would decide."""
    least, most = TOLERATED
    if ratio - half > most or not math.isfinite(ratio + half):  # NEES is not finite: P is no covariance
        return "overconfident", None
    if ratio + half < least:
        return "underconfident", None
    if least <= ratio - half and ratio + half <= most:
        return "consistent", None
    distance = max(min(abs(ratio - least), abs(ratio - most)), 1e-3)
    return "undecided", math.ceil(runs * (half / distance) ** 2)
