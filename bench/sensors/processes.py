"""What changes slowly: Gauss-Markov stages, the flicker of a bias made of them, and first-order lags."""

from __future__ import annotations

from functools import lru_cache

import numpy as np

from bench.arrays import FloatArray
from bench.compiled import kernel
from bench.signals import allan
from bench.specs import TriadSpec

# Correlation times of the flicker stages over that of the unit [1]. Three is the fewest that stay
# within 5 % of flat from 0.1 to 10 correlation times; these, spaced by 11, stay within 1 %.
_FLICKER_STAGES = (0.05, 0.55, 6.0)


@kernel
def _gauss_markov_kernel(decay: FloatArray, sd: FloatArray, noise: FloatArray, out: FloatArray) -> None:
    """Add K stationary stages to out (B, 3); decay (B-1, K), sd (K,), unit noise (B, K, 3)."""
    for stage in range(noise.shape[1]):
        for axis in range(3):
            x = sd[stage] * noise[0, stage, axis]
            out[0, axis] += x
            for k in range(1, noise.shape[0]):
                w = decay[k - 1, stage]
                x = w * x + sd[stage] * np.sqrt(1.0 - w * w) * noise[k, stage, axis]
                out[k, axis] += x


def gauss_markov(decay: FloatArray, sd: FloatArray, noise: FloatArray) -> FloatArray:
    """Return the sum of first-order Gauss-Markov stages, stationary from the first instant.

    Parameters
    ----------
    decay : (B - 1, K) array
        Correlation of each stage between neighbouring instants, ``exp(-dt / correlation)`` [1].
    sd : (K,) array
        Standard deviation of each stage.
    noise : (B, K, 3) array
        Standard normal numbers.

    Returns
    -------
    x : (B, 3) array
        The process, in the unit of ``sd``; the discretization is exact for any dt.
    """
    out = np.zeros((len(noise), 3))
    _gauss_markov_kernel(decay, sd, noise, out)
    return out


@lru_cache(maxsize=1)
def _flicker_sd() -> FloatArray:
    """Return the sds of the stages whose summed Allan variance is flat at 1 (least squares)."""
    tau = np.geomspace(0.1, 10.0, 81)
    curves = np.column_stack([allan.gauss_markov(tau, 1.0, c) ** 2 for c in _FLICKER_STAGES])
    variance = np.linalg.lstsq(curves, np.ones(len(tau)), rcond=None)[0]
    sd: FloatArray = np.sqrt(variance)
    return sd


def bias_stages(triad: TriadSpec) -> tuple[FloatArray, FloatArray]:
    """Return the correlation times (K,) [s] and sds (K,) of the stages of a bias instability.

    Raises
    ------
    ValueError
        When the correlation time is missing or the model unknown.

    Notes
    -----
    ``flicker``: the Allan deviation of the sum is flat at ``bias_instability`` from 0.1 to 10 times
    ``bias_correlation``; its sd is 2.41 times that value. ``gauss-markov``: one stage, whose Allan
    deviation peaks at ``bias_instability``.

    Examples
    --------
    >>> correlation, sd = bias_stages(TriadSpec(bias_instability=1.0, bias_correlation=100.0))
    >>> print(correlation, f"{np.hypot.reduce(sd):.2f}")
    [  5.  55. 600.] 2.41
    """
    if not triad.bias_correlation > 0:
        raise ValueError(
            f"bias_instability needs a bias_correlation above 0 s; got {triad.bias_correlation:g} s"
        )
    if triad.bias_model == "flicker":
        return triad.bias_correlation * np.array(_FLICKER_STAGES), triad.bias_instability * _flicker_sd()
    if triad.bias_model == "gauss-markov":
        return np.array([triad.bias_correlation]), np.array([triad.instability_sd])
    raise ValueError(f"bias_model must be 'flicker' or 'gauss-markov'; got {triad.bias_model!r}")


def noise_terms(triad: TriadSpec, step: float = 0.0) -> dict[str, allan.Covariance]:
    """Return the random processes of a triad at rest, by name; what it does not have is not there.

    Parameters
    ----------
    triad : TriadSpec
        Its figures.
    step : float
        Between the instants its biases are simulated at; 0 for the biases themselves [s].

    Notes
    -----
    Constant biases have no Allan deviation. Temperature bias, vibration and what follows the motion are left
    out: this is a unit at rest and at one temperature. Quantization is that of the integral.
    """
    terms: dict[str, allan.Covariance] = {}
    if triad.quantization > 0:
        terms["quantization"] = allan.quantization(triad.quantization)
    if triad.random_walk > 0:
        terms["white noise"] = allan.white(triad.random_walk)
    if triad.bias_instability > 0:
        stages = [allan.markov(s, c, step) for c, s in zip(*bias_stages(triad), strict=True)]
        terms["bias instability"] = allan.total(*stages)
    if triad.rate_random_walk > 0:
        terms["rate random walk"] = allan.rate_walk(triad.rate_random_walk, step)
    return terms


@kernel
def lag_kernel(t: FloatArray, wanted: FloatArray, start: float, time: float, out: FloatArray) -> None:
    """First-order lag of wanted (B,), linear between the instants t (B,)."""
    x = start
    out[0] = x
    for k in range(1, len(t)):
        dt = t[k] - t[k - 1]
        decay = np.exp(-dt / time)
        slope = (wanted[k] - wanted[k - 1]) / dt
        x = wanted[k] - slope * time + (x - wanted[k - 1] + slope * time) * decay
        out[k] = x


def lagged(t: FloatArray, wanted: FloatArray, start: float, time: float) -> FloatArray:
    """Return what follows a quantity with a time constant; at once when that is 0.

    Parameters
    ----------
    t : (B,) array
        Instants [s].
    wanted : (B,) array
        What is followed, linear between the instants; the answer is exact for that.
    start : float
        Where it starts, in the unit of ``wanted``.
    time : float
        Time constant [s].
    """
    if time <= 0:
        return wanted
    out = np.empty_like(wanted)
    lag_kernel(t, wanted, start, time, out)
    return out
