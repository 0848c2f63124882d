"""Path errors of a flight that an estimate guided, as vectors: TSE = FTE - NSE.

The total system error is from the desired path to the truth, the flight technical error from the desired path
to the estimated path, the navigation system error from the truth to the estimated path (RTCA DO-236C, where
the sign of NSE is the other one). All are at the same epoch and in the axes of the path.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Literal

import numpy as np

from bench.core.mathematics import earth
from bench.core.mathematics.arrays import FloatArray
from bench.core.records.run_records import OffPath
from bench.evaluation.metrics.case import Case

Part = Literal["tse", "fte", "nse"]
PARTS: tuple[Part, ...] = ("tse", "fte", "nse")


def resolve(case: Case) -> dict[Part, dict[str, FloatArray]]:
    """Return the three errors (M,) [m], ``across`` to the right of the path and ``up``; {} without a path."""
    return {} if case.path is None else resolve_along(case.path, case.pos_n)


def resolve_along(path: OffPath, pos_n: FloatArray) -> dict[Part, dict[str, FloatArray]]:
    """Return the three errors of :func:`resolve` for an estimate with the error ``pos_n`` (M, 3) [m], n."""
    north, east, down = pos_n.T
    nse = {"across": east * np.cos(path.course) - north * np.sin(path.course), "up": -down}
    tse = {"across": path.right, "up": path.above}
    fte = {axis: tse[axis] + nse[axis] for axis in tse}
    return {"tse": tse, "fte": fte, "nse": nse}


def locate_path(path: OffPath, lla: FloatArray) -> FloatArray:
    """Return the path point nearest to each true position (M, 3); NaN without a path.

    Where it has no height of its own it is as high as the truth.
    """
    back = -path.right
    above = np.where(np.isnan(path.above), 0.0, path.above)
    off_n = np.column_stack([-back * np.sin(path.course), back * np.cos(path.course), above])
    return earth.displace(lla, off_n)


def measure(part: Part, case: Case) -> Mapping[str, float | None]:
    """Path error of a flight that an estimate guided, RMS and largest value, across the path and up [m]."""
    found: dict[str, float | None] = {}
    errors = resolve(case)
    for axis in ("across", "up") if errors else ():
        values = errors[part][axis][np.isfinite(errors["tse"][axis])]
        if len(values):
            found[f"{axis}_rms"] = float(np.sqrt(np.mean(values**2)))
            found[f"{axis}_max"] = float(np.abs(values).max())
    return found
