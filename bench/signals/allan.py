"""Analytic Allan deviation of the processes sensor errors are made of."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from bench.arrays import FloatArray


def gauss_markov(tau: ArrayLike, sd: float, correlation: ArrayLike) -> FloatArray:
    """Return the Allan deviation of a stationary first-order Gauss-Markov rate.

    Parameters
    ----------
    tau : float or array
        Averaging time [s].
    sd : float
        Standard deviation of the process [unit/s].
    correlation : float or array
        Correlation time, broadcast against ``tau`` [s].

    Returns
    -------
    adev : array
        Allan deviation of the process [unit/s]; its peak is 0.617 sd at 1.89 correlation times.

    Notes
    -----
    With ``x = tau / correlation`` the Allan variance is half the variance of the difference of two
    adjacent averages of a process with autocovariance ``sd^2 exp(-|lag| / correlation)``:
    ``2 sd^2 / x (1 - (3 - 4 exp(-x) + exp(-2 x)) / (2 x))``, as in IEEE Std 952-1997, annex C.

    Examples
    --------
    >>> print(f"{gauss_markov(1.89, sd=1.0, correlation=1.0):.3f}")
    0.617
    """
    x = np.asarray(tau, float) / np.asarray(correlation, float)
    variance = 2 * sd**2 / x * (1 - (3 - 4 * np.exp(-x) + np.exp(-2 * x)) / (2 * x))
    adev: FloatArray = np.sqrt(variance)
    return adev
