"""Fit white noise, bias instability, rate random walk and quantization to a record at rest, with intervals.

Maximum likelihood (`noise_spectrum`). An interval contains every value whose likelihood, maximized over the
other parameters, has a logarithm within 2.3 of the largest. By the theorem of Wilks 1.92 is enough for 95 %;
the rest is for the course of the bias instability, which is chosen, too: simulated records have 95 % or more.
If an interval reaches 0, the parameter is not identified.

A turn-on transient and the effect of the temperature are regressors, integrated out of the likelihood
(restricted maximum likelihood: Patterson and Thompson, Biometrika 58, 1971), so that their removal does not
reduce the slow noise.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from scipy.optimize import brentq, minimize_scalar
from scipy.stats import chi2

from bench.core.mathematics.arrays import FloatArray
from bench.core.records.sensor_specs import AxisFigures, TriadSpec
from bench.evaluation.motion.noise_spectrum import (
    ALONE,
    PARAMETERS,
    NoiseSpectrum,
    add_regressors,
    estimate_effects,
    make_shapes,
    make_spectrum,
    solve,
)

FEWEST = 1024
"""Fewest samples of a fit."""
SLOW = ("rate_random_walk", "bias_instability")
MODELS = ("flicker", "gauss-markov")
"""Courses of the bias instability: the first that is likely is taken; the intervals contain both."""
_LONGEST = {"flicker": 1 / 3, "gauss-markov": 1 / 10}  # correlation time over the record; beyond it is a walk
_SHORTEST = {"flicker": (100.0, 10.0), "gauss-markov": (20.0, 2.0)}  # in samples, and [s]
_DROP = 2.3  # of the logarithm of the likelihood at the ends of an interval
_TRANSIENTS = (
    0.01,
    0.03,
    0.1,
    0.3,
    1.0,
)  # time constants of a turn-on transient over the length of the record
_WARMS = 16.3  # smallest chi-square, 99.9 %, of an effect of the temperature
_SEEN = 50.0  # smallest chi-square (3 degrees of freedom) of a transient that is removed


@dataclass(frozen=True, slots=True)
class NoiseEstimate:
    """A fitted parameter in SI with its 95 % interval."""

    value: float
    low: float  # 0: not identified, the value is below ``high``
    high: float

    @property
    def identified(self) -> bool:
        """Return whether the record shows that the parameter is above 0."""
        return self.low > 0


@dataclass(frozen=True, slots=True)
class NoiseFit:
    """The random errors of one triad, fitted to a record at rest."""

    triad: str  # "gyro" or "accel"
    estimates: Mapping[str, NoiseEstimate]  # by field of `TriadSpec`; all axes have the same
    correlation: float  # correlation time of the bias instability [s]
    model: str  # its course, `TriadSpec.bias_model`
    highest: float  # frequency up to which the record has the fitted shape [Hz]
    nyquist: float  # half the sample rate [Hz]
    slow: bool  # there is a bias instability or a rate random walk, identified or not
    axes: Mapping[str, tuple[NoiseEstimate, ...]] = field(default_factory=dict)  # x, y, z, if they differ
    transient: tuple[float, FloatArray] | None = None  # time constant [s], amplitudes (3,) [unit/s]
    temperature: FloatArray | None = None  # bias per kelvin (3,), if significant [unit/s/K]

    def make_triad(self) -> TriadSpec:
        """Return the fitted figures as a triad; a parameter that is not identified is 0.

        If the record shows a slow noise, but not whether it is the bias instability or the walk, their
        likeliest values are in the triad. Transient and temperature effect enter with the rms of their axes.
        """
        kept = _choose_kept(self.estimates, self.slow)
        values: dict[str, Any] = {name: self.estimates[name].value for name in kept}
        axes = []
        for name in kept if self.axes else ():
            x, y, z = (one.value for one in self.axes[name])
            values[name] = max(x, y, z)
            if name != "quantization":
                axes.append(AxisFigures(name, x, y, z))
        if self.transient is not None:
            values |= {"transient_time": self.transient[0], "transient_sd": _rms(self.transient[1])}
        if self.temperature is not None:
            values["temperature_sd"] = _rms(self.temperature)
        if values.get("bias_instability"):
            return TriadSpec(
                **values, bias_correlation=self.correlation, bias_model=self.model, axes=tuple(axes)
            )
        return TriadSpec(**values, axes=tuple(axes))


def _rms(values: FloatArray) -> float:
    return float(np.sqrt(np.mean(np.square(values))))


def _choose_kept(estimates: Mapping[str, NoiseEstimate], slow: bool) -> list[str]:
    """Return the parameters of a datasheet: identified, or the two slow ones if neither is identified."""
    unknown = slow and not any(estimates[name].identified for name in SLOW)
    return [name for name, one in estimates.items() if one.identified or (unknown and name in SLOW)]


class _ProfiledFit:
    """The likelihood of the spectra of groups of axes that share the course of the bias instability."""

    def __init__(
        self, groups: list[NoiseSpectrum], models: Sequence[str] = MODELS, *, fine: bool = True
    ) -> None:
        self.groups, self.models, self._fine = groups, models, fine
        self._starts: dict[tuple[object, ...], FloatArray] = {}
        self._grids = {model: self._make_grid(model) for model in models}
        found = [self._maximize(model) for model in models]
        self.most = max(most for most, _, _ in found)
        chosen = next(k for k, (most, _, _) in enumerate(found) if self.most - most < _DROP)
        self.model, self.correlation = models[chosen], found[chosen][1]
        self.values = [self._fit(k, self.model, self.correlation)[0] for k in range(len(groups))]
        for model, (most, _, likelihoods) in zip(models, found, strict=True):
            # at other times no value of a parameter is likely; between two times of the grid one may be
            likely = self.most - likelihoods < _DROP
            likely[np.argmax(likelihoods)] |= self.most - most < _DROP
            self._grids[model] = self._grids[model][np.convolve(likely, np.ones(3), "same") > 0]

    def _make_grid(self, model: str) -> FloatArray:
        """Return the logarithms of the correlation times that are tried."""
        one = self.groups[0]
        samples, least = _SHORTEST[model]
        longest, shortest = _LONGEST[model] * one.samples * one.interval, max(samples * one.interval, least)
        shortest = min(shortest, 0.25 * longest)
        count = max(4, round(np.log2(longest / shortest)) + 1)
        return np.linspace(np.log(shortest), np.log(longest), count)

    def variance(self) -> FloatArray:
        """Return the fitted variance (M,) of the coefficients of the first group."""
        return self._shape(self.model, self.correlation) @ self.values[0]

    def _shape(self, model: str, correlation: float) -> FloatArray:
        one = self.groups[0]
        return make_shapes(one.index, one.samples, one.interval, correlation, model)

    def _maximize(self, model: str, *fixed: tuple[int, int, float]) -> tuple[float, float, FloatArray]:
        """Return the largest likelihood over the correlation time, that time [s], and the likelihoods
        at the times of the grid.

        With ``fixed``, (group, parameter, variance), that parameter has that value.
        """
        held = {group: (j, value) for group, j, value in fixed}
        grid = self._grids[model]
        if not len(grid):
            return -np.inf, 0.0, grid

        def lose(u: float) -> float:
            correlation = float(np.exp(u))
            return -sum(
                self._fit(g, model, correlation, *held.get(g, ()))[1] for g in range(len(self.groups))
            )

        losses = np.array([lose(u) for u in grid])
        k = int(np.argmin(losses))
        if self._fine and len(grid) > 1:
            ends = grid[max(k - 1, 0)], grid[min(k + 1, len(grid) - 1)]
            found = minimize_scalar(lose, bounds=ends, method="bounded", options={"xatol": 0.02})
            if found.fun < losses[k]:
                return -float(found.fun), float(np.exp(found.x)), -losses
        return -float(losses[k]), float(np.exp(grid[k])), -losses

    def _fit(
        self, group: int, model: str, correlation: float, fixed: int = -1, value: float = 0.0
    ) -> tuple[FloatArray, float]:
        """Return the variances of a group and their likelihood, one parameter fixed or none."""
        shapes, one = self._shape(model, correlation), self.groups[group]
        others = [j for j in range(len(PARAMETERS)) if j != fixed]
        key = (group, model, round(2.0 * np.log(correlation)), fixed)
        start = self._starts.get(key)
        if start is None:
            start = np.zeros(len(PARAMETERS))
            start[:3] = 0.3 * np.median(one.pooled / shapes[:, 1]) / np.array([1e6, 1.0, 1e6])
        offset = value * shapes[:, fixed] if fixed >= 0 else np.zeros(len(shapes))
        whole = np.zeros(len(PARAMETERS))
        whole[others], likelihood = solve(one, shapes[:, others], offset, start[others])
        if fixed >= 0:
            whole[fixed] = value
        self._starts[key] = whole
        return whole, likelihood

    def has_slow_noise(self, group: int) -> bool:
        """Return whether white noise and quantization alone are not likely."""
        shapes, one = self._shape(self.model, self.correlation)[:, :2], self.groups[group]
        alone = solve(one, shapes, np.zeros(len(shapes)), self.values[group][:2])[1]
        return self._fit(group, self.model, self.correlation)[1] - alone > 2.0 * _DROP

    def estimate(self, group: int, name: str) -> NoiseEstimate:
        """Return a parameter of a group with its interval."""
        j = PARAMETERS.index(name)
        value = float(self.values[group][j])

        def excess(fixed: float) -> float:
            found = max(self._maximize(model, (group, j, fixed))[0] for model in self.models)
            return self.most - found - _DROP

        shape, one = self._shape(self.model, self.correlation), self.groups[group]
        relative = shape[:, j] / (shape @ self.values[group])
        spread = 1.0 / np.sqrt(0.5 * float((one.count * one.power.shape[1]) @ relative**2))
        step, inside = 2.0 * spread, value
        while excess(value + step) < 0:
            inside, step = value + step, 2.0 * step
        while inside == 0.0:
            inside, step = (0.5 * step, step) if excess(0.5 * step) < 0 else (0.0, 0.5 * step)
        high = _find_root(excess, inside, value + step)
        low = 0.0
        if value > 0 and excess(0.0) > 0:
            inside, low, step = value, max(value - 2.0 * spread, 0.5 * value), 2.0 * spread
            while excess(low) < 0:
                step *= 2.0
                inside, low = low, max(value - step, 0.5 * low)
            low = _find_root(excess, inside, low)
        return NoiseEstimate(float(np.sqrt(value)), float(np.sqrt(low)), float(np.sqrt(high)))


def _find_root(excess: Callable[[float], float], inside: float, outside: float) -> float:
    """Return where a function becomes positive between two positive values, to 2 % of their distance."""
    if excess(inside) >= 0:
        return inside
    ends = np.sort(np.log([inside, outside]))
    found: float = brentq(lambda u: excess(float(np.exp(u))), *ends, xtol=0.02 * float(np.ptp(ends)))
    return float(np.exp(found))


def fit_triad(
    triad: str, rates: FloatArray, interval: float, temperature: FloatArray | None = None
) -> NoiseFit:
    """Fit the random errors of a triad to a record at rest.

    Parameters
    ----------
    triad : str
        "gyro" or "accel".
    rates : (N, 3) array
        Rates [rad/s] or specific forces [m/s^2] at equal intervals.
    interval : float
        Length of a sample [s].
    temperature : (N,) array or None
        Temperature of the sensor [K or degC], whose linear effect is removed.

    Returns
    -------
    NoiseFit
        The figures of all axes, and of each axis if a test at 1 % finds that the axes differ.

    Notes
    -----
    The fit begins with all frequencies. While the power of one of the three highest octaves differs from the
    fit by more than 3 % and five standard deviations, the highest octave is left out: there the bandwidth of
    the sensor or a vibration shapes the noise.
    """
    length = interval * len(rates)
    courses = [temperature] if temperature is not None and np.ptp(temperature) > 0 else []
    has_temperature = bool(courses)
    spectrum = make_spectrum(rates, interval)
    transient = _find_transient(spectrum, courses)
    if transient is not None:
        courses = [*courses, make_transient(len(rates), interval, transient)]
    spectrum, profile = _choose_band(add_regressors(spectrum, courses))
    effects, inverse = estimate_effects(spectrum, profile.variance())
    warms = has_temperature and float(np.sum(effects[0] ** 2) / inverse[0, 0]) > _WARMS
    estimates, slow = {name: profile.estimate(0, name) for name in PARAMETERS}, profile.has_slow_noise(0)
    return NoiseFit(
        triad,
        estimates,
        profile.correlation,
        profile.model,
        min(float(spectrum.index[-1] + 0.5 * spectrum.count[-1] + 0.5) / (2.0 * length), 0.5 / interval),
        0.5 / interval,
        slow,
        _fit_axes(spectrum, profile, _choose_kept(estimates, slow)),
        None if transient is None else (transient, effects[-1]),
        effects[0] if warms else None,
    )


def make_transient(samples: int, interval: float, time: float) -> FloatArray:
    """Return an exponential decay (N,) from 1 with a time constant [s]."""
    course: FloatArray = np.exp(-np.arange(samples) * interval / time)
    return course


def remove_effects(
    fit: NoiseFit, rates: FloatArray, interval: float, temperature: FloatArray | None
) -> FloatArray:
    """Return rates (N, 3) without the fitted transient and the fitted effect of the temperature."""
    if fit.transient is not None:
        time, amplitudes = fit.transient
        rates = rates - make_transient(len(rates), interval, time)[:, None] * amplitudes
    if fit.temperature is not None and temperature is not None:
        rates = rates - (temperature - temperature.mean())[:, None] * fit.temperature
    return rates


def _fit_axes(
    spectrum: NoiseSpectrum, profile: _ProfiledFit, kept: Sequence[str]
) -> dict[str, tuple[NoiseEstimate, ...]]:
    """Return estimates of each axis; none if the axes do not differ by a test at 1 %."""
    count = spectrum.power.shape[1]
    alone = _ProfiledFit([spectrum.select(axes=slice(k, k + 1)) for k in range(count)], (profile.model,))
    if 2.0 * (alone.most - profile.most) < chi2.ppf(0.99, len(PARAMETERS) * (count - 1)):
        return {}
    return {name: tuple(alone.estimate(k, name) for k in range(count)) for name in kept}


def _find_transient(spectrum: NoiseSpectrum, courses: Sequence[FloatArray]) -> float | None:
    """Return the time constant of an exponential transient [s]; None if no transient is significant."""
    best, found = _SEEN, None
    for part in _TRANSIENTS:
        time = part * spectrum.samples * spectrum.interval
        decay = make_transient(spectrum.samples, spectrum.interval, time)
        tried = add_regressors(spectrum, [*courses, decay])
        profile = _ProfiledFit([tried], MODELS[:1], fine=False)
        effects, inverse = estimate_effects(tried, profile.variance())
        seen = float(np.sum(effects[-1] ** 2) / inverse[-1, -1])
        if seen > best:
            best, found = seen, time
    return found


def _choose_band(spectrum: NoiseSpectrum) -> tuple[NoiseSpectrum, _ProfiledFit]:
    """Return the spectrum up to the highest frequency with the fitted shape, and the fit."""
    while True:
        profile = _ProfiledFit([spectrum])
        ratio = spectrum.pooled / profile.variance()
        octaves = np.floor(np.log2(spectrum.index[-1] / spectrum.index)).astype(int)
        count = np.bincount(octaves, spectrum.count)
        ratios = np.bincount(octaves, spectrum.count * ratio) / count
        spread = np.sqrt(2.0 / (spectrum.power.shape[1] * count))
        wrong = (np.abs(ratios - 1.0) > 0.03 + 5.0 * spread) & (count > 100.0)
        if not wrong[:3].any() or spectrum.index[-1] < 2 * ALONE:
            return spectrum, profile
        spectrum = spectrum.select(slice(0, int(np.searchsorted(-octaves, 0))))
