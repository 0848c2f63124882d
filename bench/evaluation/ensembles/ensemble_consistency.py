"""Consistency of a filter over many runs: the rule of the verdict, and its sentences.

The errors of a filter may last a whole run: a turn-on bias does. Epochs of one run are then far from
independent, so every test here takes the run as the sample, or one time of every run:

(a) the run averages of NEES, of each block and of each axis, against their expectation (`judge_ratios`);
(b) NEES averaged over the N runs (ANEES) at a few epochs declared beforehand. N ANEES is chi-square with
    n N degrees of freedom there, whatever the correlation in time;
(c) the mean NIS of each sensor. Innovations of a matched filter are independent in time.

Source: Bar-Shalom, Li, Kirubarajan, Estimation with Applications to Tracking and Navigation, 5.4.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np

from bench.core.mathematics.arrays import FloatArray, IntArray, as_float
from bench.evaluation.consistency.chi_square import NIS_PROBABILITY, MeanNis, SensorNis, mean_band, mean_nis
from bench.evaluation.ensembles.ensemble import CONFIDENCE, Estimate
from bench.evaluation.ensembles.regression import average_changes, reject_by_holm
from bench.evaluation.errors.error_series import AXIS_TITLES, TITLES

LEAST_RUNS = 8
"""Fewest runs of a campaign that are evaluated: as many as a flight of the quick card has."""

INSTANTS = 6
"""Number of epochs of test (b), evenly spaced from the first to the last epoch."""

ERROR_RATE = 0.01
"""False-alarm rate of test (a) over all blocks and axes, and of each end of an interval; half for (b) [1]."""

TOLERATED = (0.8, 1.25)
"""Range of ANEES / n in which a filter is called consistent: P is right within 25 % [1]."""

WHOLE = "all"
"""Key of the NEES of all states together."""

LEAST_INSIDE = 0.8
"""Fraction of the time with NEES in the central 95 % of its distribution: less is uneven [1]."""

Word = Literal["consistent", "overconfident", "underconfident", "undecided", "uneven"]
_OVER: Word = "overconfident"
_UNDER: Word = "underconfident"
_NAMES = {WHOLE: "all states", **TITLES, **AXIS_TITLES}
_STATES = {**dict.fromkeys(TITLES, 3), **dict.fromkeys(AXIS_TITLES, 1)}


@dataclass(frozen=True, slots=True)
class RatioVerdict:
    """The verdict of `judge_ratios`."""

    word: Word
    text: str  # the verdict, with the blocks and axes that are wrong
    ratios: Mapping[str, Estimate]  # NEES over its expectation, by block and axis; interval of 98 %
    runs_to_decide: int | None  # number of runs that would decide, if the word is "undecided"
    off: tuple[str, ...]  # the ratios that are not 1


def judge_ratios(ratios: Mapping[str, FloatArray], inside: FloatArray | None = None) -> RatioVerdict:
    """Evaluate from the scatter between runs whether NEES, its blocks and its axes are right within 25 %.

    A ratio above or below `TOLERATED` makes the filter over- or underconfident; Holm's method keeps the
    probability of any false verdict at `ERROR_RATE`. *Consistent* needs the interval of `WHOLE` inside
    `TOLERATED` (two one-sided tests of 1 %). If another ratio proves not to be 1, its interval must be
    inside too.

    Parameters
    ----------
    ratios : mapping of (R,) arrays
        Averages of NEES over its expectation in at least two runs, of all states (`WHOLE`), by block ("pos",
        "vel", "phi") and by axis ("pos_n" ... "phi_d").
    inside : (R,) array or None
        Fraction of each run with NEES in the central 95 % of its distribution; too little is *uneven*.

    Notes
    -----
    A mean of squares is skewed, its cube root is nearly normal (Wilson, Hilferty, Proceedings of the National
    Academy of Sciences 17, 1931). Its degrees of freedom are Satterthwaite's, from the scatter, and Student's
    t allows for their error. ``python -m tests.evaluation.interval_coverage`` measures the level.
    """
    from scipy.special import stdtrit

    keys, values = list(ratios), np.array(list(ratios.values()))
    mean, runs = values.mean(axis=1), values.shape[1]
    mean = np.where(np.isfinite(mean), mean, np.inf)  # not finite: P is no covariance
    with np.errstate(all="ignore"):
        spread = values.var(axis=1, ddof=1) / (9.0 * runs * np.square(mean))  # 2 / 9 over degrees of freedom
    spread = np.where(np.isfinite(spread), spread, 0.0)
    (small, _), (_, large), of_one = (
        _test_means(mean / edge, spread, runs - 1) for edge in (*TOLERATED, 1.0)
    )
    wrong, _ = reject_by_holm(np.minimum(small, large).tolist(), ERROR_RATE)
    differs, _ = reject_by_holm((2.0 * np.minimum(*of_one)).tolist(), ERROR_RATE)
    reach = float(stdtrit(runs - 1, 1.0 - ERROR_RATE)) * np.sqrt(spread)
    with np.errstate(divide="ignore"):
        low, high = (mean / np.maximum(1.0 - spread + way, 0.0) ** 3 for way in (reach, -reach))
    found = {key: Estimate(*map(float, ends)) for key, *ends in zip(keys, mean, low, high, strict=True)}
    words = {
        key: _UNDER if found[key].value < 1.0 else _OVER for key, bad in zip(keys, wrong, strict=True) if bad
    }
    off = tuple(key for key, bad in zip(keys, differs, strict=True) if bad)
    loose = [key for key in off if not _is_tolerated(found[key])]
    loose = loose if _is_tolerated(found[WHOLE]) else [WHOLE]
    share = None if inside is None else estimate_share(inside)
    word: Word = "undecided" if loose else "consistent"
    text: str = word
    if words:
        word = _OVER if _OVER in words.values() else _UNDER
        text = ", ".join(_name_wrong(words, found))
    elif share and share.high < LEAST_INSIDE and TOLERATED[0] <= found[WHOLE].value <= TOLERATED[1]:
        word = "uneven"
        text = f"uneven, in the central 95 % of its distribution for {100 * share.value:.3g} % of the time"
    elif loose and loose != [WHOLE]:
        text = f"undecided in {_name_ratios(loose, found, set())}"
    needed = max(_count_deciding(found[key], runs) for key in loose) if word == "undecided" else None
    return RatioVerdict(word, text, found, needed, off)


def read_ratios(rows: Sequence[Mapping[str, Any]]) -> dict[str, FloatArray]:
    """Return the ratios of blocks and axes from the metrics of runs; only ratios that all runs have."""
    columns = {key: [row.get(f"nees_ratio_{key}") for row in rows] for key in _STATES}
    return {key: np.array(values, float) for key, values in columns.items() if rows and None not in values}


def read_inside(rows: Sequence[Mapping[str, Any]]) -> FloatArray | None:
    """Return the fractions of time with NEES in its central 95 %, by run; None if unknown."""
    values = [row.get("nees_inside_95") for row in rows]
    return np.array(values, float) if values and None not in values else None


def estimate_share(by_run: FloatArray) -> Estimate:
    """Return the mean of the fractions by run, with an interval by Student's t."""
    mean = average_changes(by_run)
    low, high = mean.interval(1.0 - CONFIDENCE)
    return Estimate(mean.estimate, max(low, 0.0), min(high, 1.0))


def _test_means(ratio: FloatArray, spread: FloatArray, dof: int) -> tuple[FloatArray, FloatArray]:
    """Return the p-values of means over their hypothesis (K,) that are too small, and too large."""
    from scipy.special import stdtr

    with np.errstate(all="ignore"):
        score = (np.cbrt(ratio) - 1.0 + spread) / np.sqrt(spread)
    score = np.where(np.isnan(score), 0.0, score)
    return stdtr(dof, score), stdtr(dof, -score)


def _is_tolerated(ratio: Estimate) -> bool:
    return TOLERATED[0] <= ratio.low and ratio.high <= TOLERATED[1]


def _name_wrong(words: Mapping[str, Word], ratios: Mapping[str, Estimate]) -> Iterator[str]:
    """Yield each word with its blocks, and its axes in other blocks; alone if all blocks have it."""
    told: set[int] = set()
    for word in (_OVER, _UNDER):
        mine = [key for key, one in words.items() if one == word]
        parts = [key for key in mine if key in TITLES or words.get(key.partition("_")[0]) != word]
        parts = [key for key in parts if key != WHOLE]
        if mine:
            whole = not parts or all(words.get(block) == word for block in TITLES if block in ratios)
            yield word if whole else f"{word} in {_name_ratios(parts, ratios, told)}"


def _name_ratios(keys: Sequence[str], ratios: Mapping[str, Estimate], told: set[int]) -> str:
    """Return blocks and axes with their ratios in words; ``told`` are the numbers of states explained."""
    parts = []
    for key in keys:
        states, value = _STATES[key], ratios[key].value
        head = "" if states in told else "NEES is " if states == 1 else f"NEES/{states} is "
        told.add(states)
        parts.append(f"{_NAMES[key]} ({head}{value:.3g})")
    return ", ".join(parts)


def _count_deciding(ratio: Estimate, runs: int) -> int:
    """Return the number of runs whose interval would exclude the nearer edge of `TOLERATED`."""
    half = 0.5 * (ratio.high - ratio.low) if math.isfinite(ratio.high) else ratio.value - ratio.low
    distance = max(min(abs(ratio.value - edge) for edge in TOLERATED), 1e-3)
    return math.ceil(runs * (half / distance) ** 2)


@dataclass(frozen=True, slots=True)
class Consistency:
    """Consistency of a filter over runs: the verdict, its interval, and the tests."""

    states: int  # n, the expected NEES
    runs: int
    mean: float  # of NEES over all runs and epochs
    ratio: float  # ANEES / n: 1 is expected
    low: float  # interval of the ratio, 98 %
    high: float
    word: Word
    text: str  # the word, with the blocks and axes that are wrong
    parts: Mapping[str, Estimate]  # ratios by block and axis, 98 %
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
            f"{self.text}: ANEES / {self.states} is {self.ratio:.2f}, {self.low:.2f} to {self.high:.2f} "
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
    rows: Sequence[Mapping[str, Any]] = (),
) -> Consistency:
    """Evaluate from many runs whether the covariance of a filter describes its errors.

    The filter is *rejected* if one of the tests (a), (b), (c) of this module fails. A matched filter is
    rejected in less than 2 % of all cases, also if its errors last the whole run. With many runs the tests
    find errors of P that do not matter, so the *word* comes from the size of the error (`judge_ratios`).

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
    rows : sequence of mapping
        Metrics of the R runs, for the blocks and axes; none: of all states only.

    Raises
    ------
    ValueError
        If there are fewer than `LEAST_RUNS` runs, no epochs, or no updates of a sensor.
    """
    nees = as_float("nees", nees, (None, None), finite=False)
    runs, epochs = nees.shape
    if runs < LEAST_RUNS or epochs < 1:
        raise ValueError(f"nees must hold at least {LEAST_RUNS} runs and 1 epoch; got {runs} and {epochs}")
    if instants is None:
        instants = np.unique(np.linspace(0, epochs - 1, INSTANTS).astype(np.int64)).tolist()
    at = np.asarray(instants, np.int64)
    averages = nees.mean(axis=1)
    judged = judge_ratios({**read_ratios(rows), WHOLE: averages / states}, read_inside(rows))
    anees = nees[:, at].mean(axis=0)
    band = mean_band(states, runs, 1.0 - 0.5 * ERROR_RATE / len(at))
    sensors = {
        name: series
        if isinstance(series, MeanNis)
        else mean_nis(np.concatenate([s.nis for s in series]), np.concatenate([s.dof for s in series]))
        for name, series in nis.items()
    }
    reasons = []
    if judged.off:
        told = ", ".join(f"{_NAMES[key]} {judged.ratios[key].value:.3g}" for key in judged.off)
        reasons.append(
            f"NEES over its expectation is not 1, with {1 - ERROR_RATE:.0%} from {runs} runs: {told}"
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
    ratio = judged.ratios[WHOLE]
    return Consistency(
        states=states,
        runs=runs,
        mean=float(averages.mean()),
        ratio=ratio.value,
        low=ratio.low,
        high=ratio.high,
        word=judged.word,
        text=judged.text,
        parts={key: one for key, one in judged.ratios.items() if key != WHOLE},
        runs_to_decide=judged.runs_to_decide,
        instants=at,
        anees=anees,
        band=band,
        nis=sensors,
        reasons=tuple(reasons),
    )
