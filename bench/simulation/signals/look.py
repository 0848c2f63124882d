"""Directions of satellites, atmospheric delays, and the errors of ranges after their correction."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from bench.core.compilation.compiled import on_arrays
from bench.core.mathematics import earth
from bench.core.mathematics.arrays import FloatArray, IntArray
from bench.simulation.signals.delays import (
    compute_ntcm,
    klobuchar_kernel,
    mapping_kernel,
    obliquity_kernel,
    range_kernel,
    zenith_troposphere,
)
from bench.simulation.signals.least_squares import Shared, find_pierce_points
from bench.simulation.signals.orbits import GPS_EARTH_RATE, L1
from bench.simulation.signals.processing import ErrorBudget, Processing

_range, _klobuchar = on_arrays(range_kernel), on_arrays(klobuchar_kernel)
_obliquity, _mapping = on_arrays(obliquity_kernel), on_arrays(mapping_kernel)
_LOWEST = 0.01  # sine of the elevation below which the cosecant is that of it [1]


class Look(NamedTuple):
    """Directions and atmospheric delays of satellites from an assumed position of the receiver."""

    pos_e: FloatArray  # (M, 3) [m], e
    lla: FloatArray  # (M, 3) [rad, rad, m]
    los_n: FloatArray  # (K, 3) receiver to satellite, n
    el: FloatArray  # (K,) elevation [rad]
    ionosphere: FloatArray  # (K,) delay by the broadcast model on the row's carrier [m]
    troposphere: FloatArray  # (K,) [m]


def compute_look(
    pos_e: FloatArray,
    *,
    epoch_start: IntArray,
    t: FloatArray,
    sat_pos_e: FloatArray,
    frequency: FloatArray,
    klobuchar: FloatArray,
    processing: Processing,
) -> Look:
    """Compute directions and atmospheric delays of satellites.

    Parameters
    ----------
    pos_e : (M, 3) array
        Receiver at each epoch [m]; rows with NaN give NaN.
    epoch_start : (M + 1,) array of int
        First row of each epoch.
    t : (K,) array
        GPS time of day [s].
    sat_pos_e : (K, 3) array
        [m], e at transmission.
    frequency : (K,) array
        Carrier [Hz].
    klobuchar : (8,) array
        Broadcast ionosphere.
    processing : Processing
        Models of the delays; without "sagnac" satellites do not turn with the Earth during the travel time.
    """
    epoch = np.repeat(np.arange(len(pos_e)), np.diff(epoch_start))
    lla = earth.to_geodetic(pos_e)
    rate = 0.0 if "sagnac" in processing.without else GPS_EARTH_RATE
    _, *direction = _range(*sat_pos_e.T, *pos_e[epoch].T, rate)
    C_en = earth.matrix_en(lla[:, 0], lla[:, 1])
    los_n = np.einsum("kij,ki->kj", C_en[epoch], np.stack(direction, axis=-1))
    sin_el = -los_n[:, 2]
    el = np.arctan2(sin_el, np.hypot(los_n[:, 0], los_n[:, 1]))
    zenith = zenith_troposphere(
        lla[:, 0], lla[:, 2], processing.troposphere, processing.weather, processing.day
    )[epoch]
    return Look(
        pos_e,
        lla,
        los_n,
        el,
        _compute_ionosphere(lla[epoch], los_n, el, t, klobuchar, processing) * (L1 / frequency) ** 2,
        zenith * map_troposphere(sin_el, processing),
    )


def map_troposphere(sin_el: FloatArray, processing: Processing) -> FloatArray:
    """Return the ratio of slant to vertical delay of the troposphere (K,)."""
    if processing.mapping == "cosecant":
        return np.asarray(1.0 / np.maximum(sin_el, _LOWEST))
    return np.asarray(_mapping(sin_el))


def _compute_ionosphere(
    lla: FloatArray,
    los_n: FloatArray,
    el: FloatArray,
    t: FloatArray,
    klobuchar: FloatArray,
    processing: Processing,
) -> FloatArray:
    """Return the delay on L1 (K,) [m], 0 below the horizon."""
    delay = np.zeros(len(el))
    rows = np.flatnonzero(el > 0.0)
    if processing.ionosphere == "ntcm-g" and processing.level is not None:
        azimuth = np.arctan2(los_n[rows, 1], los_n[rows, 0])
        hour = t[rows] % 86400.0 / 3600.0  # GPS time for UT: 18 s move the Sun by 0.08 deg
        level, day = processing.level, processing.day
        delay[rows] = compute_ntcm(lla[rows, 0], lla[rows, 1], el[rows], azimuth, hour, day, level)
    elif processing.ionosphere == "klobuchar":
        across = np.maximum(np.hypot(los_n[rows, 0], los_n[rows, 1]), 1e-12)
        sine, cosine = los_n[rows, 1] / across, los_n[rows, 0] / across
        delay[rows] = _klobuchar(lla[rows, 0], lla[rows, 1], el[rows], sine, cosine, t[rows], klobuchar)
    return delay


def share_errors(near: Look, frequency: FloatArray, processing: Processing) -> Shared:
    """Return the atmospheric errors that the corrections of ``processing`` leave in ranges (K,)."""
    budget, el = processing.budget, np.maximum(near.el, 0.0)
    slant = _obliquity(el) * (L1 / frequency) ** 2
    delay = np.maximum(near.ionosphere / slant, budget.ionosphere_night)
    vertical: FloatArray = np.hypot(budget.zenith_ionosphere, budget.ionosphere_share * delay)
    if processing.ionosphere == "none" or "ionosphere" in processing.without:
        vertical = np.full(len(el), budget.ionosphere_none)
    elif processing.ionosphere == "free":
        vertical = np.zeros(len(el))
    below = budget.zenith_troposphere * map_troposphere(np.sin(el), processing)
    return Shared(vertical * slant, below, find_pierce_points(near.los_n, near.el), budget.ionosphere_decay)


def estimate_range_sd(
    el: FloatArray,
    frequency: FloatArray,
    code: FloatArray,
    space: FloatArray,
    budget: ErrorBudget,
    free: bool,
) -> FloatArray:
    """Return the sigma (K,) [m] of the errors that ranges do not have in common; NaN below the horizon.

    ``code`` (K,) is the noise of the receiver on the first band [m], ``space`` (K,) that of ephemeris and
    clock. With ``free`` both carriers ``frequency`` (K, 2) are combined (B-11), which multiplies noise and
    multipath.
    """
    multipath = budget.multipath_zenith + budget.multipath_horizon * np.exp(-el / budget.multipath_decay)
    tracking = code**2 + multipath**2
    if free:
        gamma = (frequency[:, 1] / frequency[:, 0]) ** 2
        tracking = tracking * (1.0 + (gamma * budget.second_band) ** 2) / (1.0 - gamma) ** 2
    return np.asarray(np.where(el > 0.0, np.sqrt(space**2 + tracking), np.nan))
