"""Statistics over many runs of one filter, each with a confidence interval.

The runs are independent, the epochs of one run are not: an error may last the whole run. So every interval
here comes from the differences between runs. Its confidence is `CONFIDENCE` unless said otherwise.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from bench.core.mathematics.arrays import BoolArray, FloatArray
from bench.core.records.data import Innovations
from bench.core.words.notebook import ShownFigure
from bench.core.words.wording import format_number
from bench.evaluation.ensembles import regression

CONFIDENCE = 0.95
"""Confidence of an interval [1]."""

SAME = 0.05
"""Ratios nearer to 1 than this make no difference to whoever buys or tunes [1]."""

ENOUGH = 59
"""Fewest runs that include one of the largest 5 % with a probability of 95 %: 1 - 0.95^59."""

LAGS = 20
"""Number of lags of the test of whiteness."""


@dataclass(frozen=True, slots=True)
class Estimate:
    """A figure and its confidence interval."""

    value: float
    low: float
    high: float

    @property
    def interval(self) -> str:
        """The interval in words, with three digits."""
        return f"{format_number(self.low, 3)} to {format_number(self.high, 3)}"

    def show(self, digits: int = 4) -> ShownFigure:
        """Return the figure and its interval for a table."""
        return ShownFigure(format_number(self.value, digits), self.interval)


def qualify(runs: int) -> str:
    """Return the words that intervals of pooled errors of so many runs need; "" if there are `ENOUGH`."""
    return ", if no rare large run exists" if runs < ENOUGH else ""


@dataclass(frozen=True, slots=True)
class Quantile:
    """A quantile of a sample and its confidence interval; a limit is None if there are too few values."""

    value: float
    low: float | None
    high: float | None


# --- errors ----------------------------------------------------------------------------------------------


def pool_rmse(mean_squares: FloatArray, confidence: float = CONFIDENCE) -> Estimate:
    """Return the RMSE over all runs: squares are averaged, not roots.

    Parameters
    ----------
    mean_squares : (R,) array
        Mean square error of each run.

    Returns
    -------
    rmse : Estimate
        Interval by the jackknife of its logarithm, Student's t with R - 1 degrees of freedom. With 40 runs
        it holds the truth in 94 instead of 95 %.
    """
    from scipy.special import stdtrit

    n = len(mean_squares)
    with np.errstate(divide="ignore"):
        left_out = 0.5 * np.log((mean_squares.sum() - mean_squares) / (n - 1))
    error = np.sqrt((n - 1) / n * np.square(left_out - left_out.mean()).sum())
    half = float(stdtrit(n - 1, 0.5 + 0.5 * confidence) * error)
    value = float(np.sqrt(mean_squares.mean()))
    return Estimate(value, value * float(np.exp(-half)), value * float(np.exp(half)))


def estimate_quantile(values: FloatArray, fraction: float, confidence: float = CONFIDENCE) -> Quantile:
    """Return a quantile of independent values with its distribution-free confidence interval.

    The number of values below the true quantile is binomial for any distribution, so order statistics
    enclose it (David, Nagaraja, Order Statistics, 3rd ed., 7.1). Each limit fails with probability
    (1 - confidence) / 2. Values may be infinite: of times, "never".

    Examples
    --------
    >>> estimate_quantile(np.arange(1.0, 11.0), 0.5)  # of ten values the second and the ninth
    Quantile(value=5.5, low=2.0, high=9.0)
    """
    from scipy.special import bdtr

    ordered, n = np.sort(values), len(values)
    below = bdtr(np.arange(n), n, fraction)  # P(at most k of n below the true quantile)
    tail = 0.5 * (1.0 - confidence)
    lower = np.flatnonzero(below <= tail)  # the k-th value (from 1) exceeds it with P(at most k - 1)
    upper = np.flatnonzero(below >= 1.0 - tail)
    finite = bool(np.isfinite(ordered).all())
    value = np.quantile(ordered, fraction, method="linear" if finite else "inverted_cdf")
    return Quantile(
        float(value),
        float(ordered[lower[-1]]) if len(lower) else None,
        float(ordered[upper[0]]) if len(upper) else None,
    )


def pool_quantile(values: FloatArray, fraction: float, confidence: float = CONFIDENCE) -> Estimate:
    """Return a quantile over all runs and epochs: CEP (0.5) and R95 of horizontal errors, SEP of 3D errors.

    Parameters
    ----------
    values : (R, M) array
        Sizes of the errors, of R independent runs at M epochs.

    Returns
    -------
    quantile : Estimate
        Interval between the order statistics at the ends of the interval of the fraction below the
        quantile, which allows for epochs that are alike (Woodruff, Journal of the American Statistical
        Association 47, 1952).
    """
    ordered = np.sort(values, axis=None)
    value = float(np.quantile(ordered, fraction, method="inverted_cdf"))
    below = estimate_fraction(values <= value, confidence)
    shift = fraction - below.value  # below 1 / (R M)
    ends = np.clip([below.low + shift, below.high + shift], 0.0, 1.0)
    low, high = np.quantile(ordered, ends, method="inverted_cdf")
    return Estimate(value, float(low), float(high))


@dataclass(frozen=True, slots=True)
class Growth:
    """Growth of the horizontal error over runs, after a time without GNSS."""

    elapsed: float  # since the start of the outage [s]
    rms: Estimate  # [m]
    median: Quantile  # [m]
    p95: Quantile  # [m]


def measure_growth(
    t: FloatArray, pos_n: FloatArray, start: float, elapsed: Sequence[float]
) -> tuple[Growth, ...]:
    """Return the growth of the horizontal error for each duration of the outage.

    Parameters
    ----------
    t : (M,) array
        Epochs [s].
    pos_n : (R, M, 3) array
        Position errors of R runs [m], n.
    start : float
        Start of the outage [s].
    elapsed : sequence of float
        Durations [s]; each is taken at the last epoch not after it.
    """
    first = int(np.searchsorted(t, start, "right")) - 1
    rows = []
    for duration in elapsed:
        last = int(np.searchsorted(t, start + duration, "right")) - 1
        if not 0 <= first <= last:
            raise ValueError(f"no epoch within {duration:g} s of the outage at {start:g} s")
        size = np.hypot(*(pos_n[:, last, :2] - pos_n[:, first, :2]).T)
        quantiles = (estimate_quantile(size, fraction) for fraction in (0.5, 0.95))
        rows.append(Growth(duration, pool_rmse(size**2), *quantiles))
    return tuple(rows)


# --- consistency -----------------------------------------------------------------------------------------


def estimate_fraction(inside: BoolArray, confidence: float = CONFIDENCE) -> Estimate:
    """Return the fraction of true values (R, M) over R runs of M epochs: coverage of k sigma, for example.

    The interval is Clopper and Pearson's for the number of independent values that would vary as much
    between runs as the fractions do (Korn, Graubard, Survey Methodology 24, 1998). Their variance is known
    from as many degrees of freedom as runs contribute to it: few, if the false values are in a few runs. If
    all values are equal, each run counts as one.
    """
    from scipy.special import stdtrit

    runs, epochs = inside.shape
    by_run = inside.mean(axis=1)
    p = float(by_run.mean())
    variance = float(by_run.var(ddof=1)) / runs
    n = float(runs)
    if 0.0 < p < 1.0:
        n = float(runs * epochs)
        if variance > 0.0:
            tail = 0.5 + 0.5 * confidence
            independent = p * (1.0 - p) / variance
            squares = np.square(by_run - p)
            dof = max(float(squares.sum() ** 2 / np.square(squares).sum()) - 1.0, 1.0)
            shrink = (stdtrit(max(independent - 1.0, 1.0), tail) / stdtrit(dof, tail)) ** 2
            n = min(n, independent * min(float(shrink), 1.0))
    return _clopper_pearson(p * n, n, confidence)


def estimate_rate(count: int, n: int, confidence: float = CONFIDENCE) -> Estimate:
    """Return the probability of an event, such as a divergence, that happened in ``count`` of n runs.

    Interval of Clopper and Pearson (Biometrika 26, 1934): it holds the rate at least as often as it says.

    Examples
    --------
    >>> round(estimate_rate(0, 40).high, 3)  # never in 40 runs: less than 9 %
    0.088
    """
    return _clopper_pearson(float(count), float(n), confidence)


def _clopper_pearson(count: float, n: float, confidence: float) -> Estimate:
    from scipy.special import betaincinv

    tail = 0.5 * (1.0 - confidence)
    low = float(betaincinv(count, n - count + 1.0, tail)) if count > 0 else 0.0
    high = float(betaincinv(count + 1.0, n - count, 1.0 - tail)) if count < n else 1.0
    return Estimate(count / n, low, high)


@dataclass(frozen=True, slots=True)
class Whiteness:
    """Correlation in time of the innovations of one component, over all runs."""

    correlation: FloatArray  # (L,) at lags 1 ... L updates
    band: float  # 99.9 % of a single one lie within +- band if the innovations are white
    p_value: float  # of all lags together
    updates: int


def measure_whiteness(normalized: Sequence[FloatArray], lags: int = LAGS) -> Whiteness:
    """Return the autocorrelation of normalized innovations, one series of updates in order for each run.

    The p-value is from the test of Box and Pierce with the variance of Ljung and Box (Biometrika 65, 1978),
    applied to the sum over runs. No mean is removed, because innovations of a matched filter have zero mean.

    Raises
    ------
    ValueError
        If the series are not longer than the lags.
    """
    from scipy.special import gammaincc, ndtri

    total = sum(len(z) for z in normalized)
    if total - lags * len(normalized) < 1:
        raise ValueError(f"{total} updates in {len(normalized)} runs are too few for {lags} lags")
    power = sum(float(z @ z) for z in normalized)
    pairs = np.array([sum(max(len(z) - k, 0) for z in normalized) for k in range(1, lags + 1)])
    sums = [sum(float(z[k:] @ z[:-k]) for z in normalized) for k in range(1, lags + 1)]
    r = np.array(sums) / power
    q = float(np.sum((r * total) ** 2 / pairs))
    return Whiteness(r, float(-ndtri(0.0005)) / total**0.5, float(gammaincc(0.5 * lags, 0.5 * q)), total)


def normalize_innovations(
    innovations: Innovations, sensor: str, component: int, begin: float = -np.inf
) -> FloatArray:
    """Return the innovations of one component of a sensor over their predicted standard deviations (K,)."""
    code = innovations.sensor.index(sensor)
    rows = (innovations.code == code) & (innovations.component == component) & (innovations.t >= begin)
    return np.asarray(innovations.z[rows] / np.sqrt(innovations.S[rows]))


def sum_repetition(innovations: Innovations, begin: float, end: float = np.inf) -> dict[str, FloatArray]:
    """Return the sums of one run in [begin, end) [s] that :func:`measure_repetition` pools, by sensor.

    Returns
    -------
    sums : dict of (3,) array
        Products of neighboring normalized innovations, their squares, and the number of neighbors, summed
        over the components.
    """
    found = {}
    for code, sensor in enumerate(innovations.sensor):
        inside = (innovations.code == code) & (innovations.t >= begin) & (innovations.t < end)
        sums = np.zeros(3)
        for component in np.unique(innovations.component[inside]).tolist():
            rows = inside & (innovations.component == component)
            z = innovations.z[rows] / np.sqrt(innovations.S[rows])
            sums += [z[1:] @ z[:-1], z @ z, max(len(z) - 1, 0)]
        found[sensor] = sums
    return found


def measure_repetition(runs: Sequence[Mapping[str, FloatArray]]) -> dict[str, tuple[float, float]]:
    """Return the correlation of innovations from one update to the next, over all runs, by sensor.

    Returns
    -------
    repetition : dict of (float, float)
        Their correlation at a lag of one update, 0 for a matched filter, and the edge of the band that
        holds 99.9 % of it then.
    """
    from scipy.special import ndtri

    total: dict[str, FloatArray] = {}
    for sums in runs:
        for sensor, one in sums.items():
            total[sensor] = total.get(sensor, np.zeros(3)) + one
    edge = -float(ndtri(0.0005))
    return {
        sensor: (float(products / power), edge / float(pairs) ** 0.5)
        for sensor, (products, power, pairs) in total.items()
        if pairs and power > 0.0
    }


# --- two filters --------------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class Comparison:
    """The pooled RMSE of two filters on the same runs."""

    first: str
    second: str
    unit: str
    difference: Estimate  # RMSE of the first minus RMSE of the second
    runs: int
    size: float  # RMSE of the second

    @property
    def sentence(self) -> str:
        """Sentence that names the better filter and the difference."""
        low, high = self.difference.low, self.difference.high
        if low <= 0.0 <= high:
            same = max(-low, high) <= SAME * self.size
            word = f"the same within {100 * SAME:g} %" if same else "undecided"
            return (
                f"{self.first} and {self.second}: {word} in {self.runs} runs, the first minus the second is "
                f"{self.difference.interval} {self.unit}{qualify(self.runs)}"
            )
        better, other = (self.second, self.first) if low > 0.0 else (self.first, self.second)
        low, high = sorted((abs(low), abs(high)))
        by = Estimate(abs(self.difference.value), low, high)
        return f"{better} is better than {other} by {by.interval} {self.unit}{qualify(self.runs)}"


def compare_rmse(
    names: tuple[str, str],
    first: FloatArray,
    second: FloatArray,
    unit: str,
    confidence: float = CONFIDENCE,
) -> Comparison:
    """Compare the pooled RMSE of two filters run by run.

    Parameters
    ----------
    names : (str, str)
        Their labels.
    first, second : (R,) array
        RMSE of each run; run k of both has the same noise.
    unit : str
        Of the RMSE.

    Returns
    -------
    comparison : Comparison
        Paired interval by the jackknife: what both have in common is not in it.
    """
    change = regression.estimate_change(second**2, first**2, np.sqrt, paired=True)
    low, high = change.interval(1.0 - confidence)
    size = float(np.sqrt(np.mean(second**2)))
    return Comparison(*names, unit, Estimate(change.estimate, low, high), len(first), size)
