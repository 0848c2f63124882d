"""Ionosphere error left by the broadcast model, as a field over the shell that signals pierce.

Signals that pierce it near each other share it: its correlation is ``exp(-distance / decay)``, as in the
covariance by which a receiver weights its ranges, times ``exp(-dt / correlation time)``. It is a sum of
waves. Wave vectors with directions and lengths from the three-dimensional Cauchy distribution of scale 1 /
decay have this correlation over the chord as their mean, since exp(-r) is its characteristic function.
"""

from __future__ import annotations

import numpy as np

from bench.core.compilation.compiled import kernel
from bench.core.mathematics import earth
from bench.core.mathematics.arrays import FloatArray, IntArray
from bench.simulation.signals.least_squares import SHELL, find_pierce_points
from bench.simulation.signals.look import Look

WAVES = 64
_TABLE = np.concatenate([np.linspace(0.0, 5.0, 2000), np.geomspace(5.0, 1e5, 2000)])
"""Lengths of wave vectors, in units of 1 / decay, of the table of their distribution."""


def draw_waves(normal: FloatArray, decay: float) -> FloatArray:
    """Return wave vectors (W, 3) [rad/m] from standard normal numbers (W, 4) and the decay [m].

    Their lengths are stratified: one in each of W parts of equal chance, for the correlation of one run to
    be near its mean. Their distribution is ``2 / pi (atan r - r / (1 + r^2))``.
    """
    from scipy.special import ndtr

    chance = (np.arange(len(normal)) + ndtr(normal[:, 3])) / len(normal)
    length = np.interp(chance, 2.0 / np.pi * (np.arctan(_TABLE) - _TABLE / (1.0 + _TABLE**2)), _TABLE)
    direction = normal[:, :3] / np.linalg.norm(normal[:, :3], axis=1, keepdims=True)
    waves: FloatArray = direction * (length / decay)[:, None]
    return waves


def locate_pierce_points(seen: Look, epoch: IntArray) -> FloatArray:
    """Return the points (K, 3) [m], e, at which signals pierce the shell; ``epoch`` (K,) of each signal."""
    flat = find_pierce_points(seen.los_n, seen.el)
    away = np.hypot(flat[:, 0], flat[:, 1])
    angle = away / SHELL
    level = flat * (np.sin(angle) / np.maximum(away, 1e-9))[:, None]
    up_n = np.column_stack([level, -np.cos(angle)])
    C_en = earth.matrix_en(seen.lla[:, 0], seen.lla[:, 1])[epoch]
    points: FloatArray = SHELL * np.einsum("kij,kj->ki", C_en, up_n)
    return points


@kernel
def field_kernel(
    first: int, stride: int, amplitudes: FloatArray, waves: FloatArray, points: FloatArray, epoch: IntArray,
    out: FloatArray,
) -> None:  # fmt: skip
    """Fill out (K,) with the field of unit variance at points (K, 3) [m] at epochs (K,).

    ``amplitudes`` (B, 2 W) of cosines and sines are unit processes with a value every ``stride`` epochs, from
    ``first`` epochs before epoch 0 on.
    """
    count = waves.shape[0]
    size = np.sqrt(1.0 / count)
    for k in range(points.shape[0]):
        j, rest = divmod(first + epoch[k], stride)
        share, total = rest / stride, 0.0
        for w in range(count):
            phase = waves[w, 0] * points[k, 0] + waves[w, 1] * points[k, 1] + waves[w, 2] * points[k, 2]
            a = amplitudes[j, w] + share * (amplitudes[j + 1, w] - amplitudes[j, w])
            b = amplitudes[j, count + w] + share * (amplitudes[j + 1, count + w] - amplitudes[j, count + w])
            total += a * np.cos(phase) + b * np.sin(phase)
        out[k] = size * total
