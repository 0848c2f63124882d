"""The errors that calibration left in a magnetometer, in its rows (`state_blocks.MAGNETOMETER`)."""

from __future__ import annotations

from bench.arrays import FloatArray
from bench.compiled import inner
from bench.navigation.error_state_filter.error_state import PHI
from bench.navigation.error_state_filter.state_blocks import Index


@inner
def calibration_kernel(
    state: FloatArray, p: FloatArray, index: Index, H: FloatArray, z: FloatArray, M: FloatArray
) -> None:
    """Add to z (3,) and H (3, n) of a true field p (3,) in b what calibration left in a magnetometer."""
    M[:] = 0.0
    for i in range(3):
        if index.mag_iron_b >= 0:
            z[i] += state[index.mag_iron_b + 1 + i]
            H[i, index.mag_iron_b + i] = 1.0
        j, k = (i + 1) % 3, (i + 2) % 3
        for at, a, b, back in (
            (index.mag_scale, i, i, 0.0),
            (index.mag_soft_iron, j, k, 1.0),
            (index.mag_turn, j, k, -1.0),
        ):
            if at >= 0:
                M[a, b] += state[at + 1 + i]
                M[b, a] += back * state[at + 1 + i]
                H[a, at + i] = p[b]
                H[b, at + i] += back * p[a]
    for i in range(3):
        z[i] += M[i, 0] * p[0] + M[i, 1] * p[1] + M[i, 2] * p[2]
        a, b, c = H[0, PHI + i], H[1, PHI + i], H[2, PHI + i]
        for j in range(3):
            H[j, PHI + i] += M[j, 0] * a + M[j, 1] * b + M[j, 2] * c
