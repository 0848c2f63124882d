"""Slow processes: Gauss-Markov stages, flicker noise of a bias as their sum, first-order lags."""

from __future__ import annotations

import numpy as np

from bench.core.compilation.compiled import kernel
from bench.core.files import disk_arrays
from bench.core.mathematics.arrays import FloatArray
from bench.core.records.sensor_specs import TriadSpec
from bench.simulation.signals import allan

# Correlation times of the flicker stages over that of the triad [1]. At least three are needed to stay within
# 5 % of a flat Allan deviation from 0.1 to 10 correlation times; these, a factor 11 apart, stay within 1 %.
_FLICKER_STAGES = (0.05, 0.55, 6.0)


@kernel
def gauss_markov_kernel(
    decay: FloatArray, sd: FloatArray, noise: FloatArray, state: FloatArray, out: FloatArray
) -> None:
    """Add K stages to out (B, 3); decay (B, K) since the time before, sd (K,), unit noise (B, K, 3).

    ``state`` (K, 3) holds the stages before the first epoch and becomes those at the last.
    """
    for stage in range(noise.shape[1]):
        for axis in range(3):
            x = state[stage, axis]
            for k in range(noise.shape[0]):
                w = decay[k, stage]
                x = w * x + sd[stage] * np.sqrt(1.0 - w * w) * noise[k, stage, axis]
                out[k, axis] += x
            state[stage, axis] = x


def simulate_gauss_markov(
    dt: FloatArray,
    correlation: FloatArray,
    sd: FloatArray,
    generator: np.random.Generator,
    before: FloatArray | None = None,
    after: FloatArray | None = None,
) -> FloatArray:
    """Simulate the sum (B, 3) of first-order Gauss-Markov stages, stationary from the first time.

    ``dt`` (B - 1,) are the intervals between the epochs, ``correlation`` (K,) the correlation times of the
    stages in the same unit, ``sd`` (K,) their standard deviations. ``generator`` draws the noise in order of
    time. The discretization is exact for any interval. With the stages ``before`` (K, 3) they go on from
    there, and dt (B,) has the interval before each time; ``after`` (K, 3) becomes those at the last.
    """
    goes_on = before is not None
    out = disk_arrays.zeros((len(dt) + 1 - goes_on, 3))
    state = np.zeros((len(sd), 3)) if before is None else before.copy()
    for rows in disk_arrays.blocks(len(out)):
        first = rows.start - 1 + goes_on
        decay = np.exp(-dt[max(first, 0) : first + rows.stop - rows.start, None] / correlation)
        if first < 0:
            decay = np.concatenate([np.zeros((1, len(sd))), decay])
        noise = generator.standard_normal((len(decay), len(sd), 3))
        gauss_markov_kernel(decay, sd, noise, state, out[rows])
    if after is not None:
        after[:] = state
    return out


def choose_bias_stages(triad: TriadSpec) -> tuple[FloatArray, FloatArray]:
    """Return the correlation times (K,) [s] and sds (K,) [unit/s] of the stages of a bias instability.

    Raises
    ------
    ValueError
        If the correlation time is missing or the model is unknown.

    Notes
    -----
    ``flicker``: the Allan deviation of the sum is flat at ``bias_instability`` from 0.1 to 10 times
    ``bias_correlation``; its sd is 2.41 times that value. ``gauss-markov``: one stage, whose Allan
    deviation peaks at ``bias_instability``.

    Examples
    --------
    >>> correlation, sd = choose_bias_stages(TriadSpec(bias_instability=1.0, bias_correlation=100.0))
    >>> print(correlation, f"{np.hypot.reduce(sd):.2f}")
    [  5.  55. 600.] 2.41
    """
    if not triad.bias_correlation > 0:
        raise ValueError(
            f"bias_instability needs a bias_correlation above 0 s; got {triad.bias_correlation:g} s"
        )
    if triad.bias_model == "flicker":
        sd = allan.fit_flat_deviation(_FLICKER_STAGES, 0.1, 10.0, 81)
        return triad.bias_correlation * np.array(_FLICKER_STAGES), triad.bias_instability * sd
    if triad.bias_model == "gauss-markov":
        return np.array([triad.bias_correlation]), np.array([triad.instability_sd])
    raise ValueError(f"bias_model must be 'flicker' or 'gauss-markov'; got {triad.bias_model!r}")


def make_noise_terms(triad: TriadSpec, step: float = 0.0) -> dict[str, allan.Covariance]:
    """Return the random processes of a triad at rest by name, without processes of size 0.

    ``step`` is the interval between the epochs of the simulated biases [s]; 0: continuous biases. Constant
    biases have no Allan deviation. The triad is at rest and at constant temperature, so temperature bias,
    vibration and errors that depend on motion are left out. Quantization acts on the integral. The variances
    are means over the axes.
    """
    triad = triad.averaged()
    terms: dict[str, allan.Covariance] = {}
    if triad.quantization > 0:
        terms["quantization"] = allan.quantization(triad.quantization)
    if triad.random_walk > 0:
        terms["white noise"] = allan.white(triad.random_walk)
    if triad.bias_instability > 0:
        stages = [allan.markov(s, c, step) for c, s in zip(*choose_bias_stages(triad), strict=True)]
        terms["bias instability"] = allan.add_processes(*stages)
    if triad.rate_random_walk > 0:
        terms["rate random walk"] = allan.rate_walk(triad.rate_random_walk, step)
    return terms


@kernel
def lag_kernel(t: FloatArray, target: FloatArray, start: float, time: float, out: FloatArray) -> None:
    """Fill out (B,) with the first-order lag of target (B,), which is linear between the epochs t (B,)."""
    x = start
    out[0] = x
    for k in range(1, len(t)):
        dt = t[k] - t[k - 1]
        decay = np.exp(-dt / time)
        slope = (target[k] - target[k - 1]) / dt
        x = target[k] - slope * time + (x - target[k - 1] + slope * time) * decay
        out[k] = x


def apply_lag(t: FloatArray, target: FloatArray, start: float, time: float) -> FloatArray:
    """Return the first-order lag, with a time constant [s], of a quantity target (B,) at epochs t (B,) [s].

    The output begins at ``start`` and is exact for an input that is linear between the epochs. A time
    constant of 0 leaves the input as it is.
    """
    if time <= 0:
        return target
    out = np.empty_like(target)
    lag_kernel(t, target, start, time, out)
    return out
