"""Processing of ranges to fixes in a receiver: ranges used, corrections, and assumed errors."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, NamedTuple

import numpy as np

from bench.core.mathematics.arrays import FloatArray, IntArray
from bench.core.records.orbit_sets import BEIDOU
from bench.simulation.signals.delays import STANDARD, Mapping, SurfaceAir, Troposphere

CORRECTIONS = ("sagnac", "relativity", "group-delay", "troposphere", "ionosphere", "clocks")
"""Corrections that ``Processing.without`` may leave out; "clocks" is a clock offset for each system."""

Ionosphere = Literal["klobuchar", "ntcm-g", "free", "none"]


class ErrorBudget(NamedTuple):
    """Standard deviations of the errors of a range; defaults for a single-frequency receiver on the ground.

    They follow from publications, not from any station. [46] RTCA DO-229D, appendix J, as in GPSTk
    ComputeMOPSWeights.cpp. [45] RTKLIB, rtkpos.c. [47] Groves, Principles of GNSS, Inertial, and Multisensor
    Integrated Navigation Systems, 2nd ed. (2013), values of its examples. [M18] Montenbruck, Steigenberger,
    Hauschild, Multi-GNSS signal-in-space range error assessment, Advances in Space Research 61 (2018),
    abstract: global average RMS of 2017, 0.2 m for Galileo, 0.6 m GPS, 1 m BeiDou-2, 2 m GLONASS.

    At night the model of GPS gives 5 ns (`delays.klobuchar_kernel`, as RTKLIB's rtkcmn.c). A model that gives
    less, as NTCM-G does, is not known better for it.
    """

    space: tuple[float, float, float, float] = (0.6, 2.0, 0.3, 0.7)
    """Ephemeris and satellite clock by system [m]: [M18]; Galileo with 0.2 m for its group delay, BeiDou-3
    between BeiDou-2 and GPS, both assumed."""
    space_beidou_2: float = 1.0  # C01 to C16 [m], [M18]
    precise: tuple[float, float, float, float] = (0.36, 0.2, 0.15, 0.4)
    """Orbit and clock of SP3 files by system [m]: 0.1 m, and what the antennas of the blocks differ along the
    axis to the Earth, because these orbits are of the center of mass and the rest goes into the clock of the
    receiver. Galileo IOV and FOC differ by 0.15 m (IGSMAIL-7356); GPS 0.35 m, GLONASS 0.17 m, BeiDou 0.4 m
    assumed."""
    delays_unknown: tuple[float, float, float, float] = (2.3, 1.4, 3.2, 7.7)
    """Beside them on one carrier, if no message gives the group delay against their clocks [m]: its sd over
    the satellites that broadcast one on 2020-06-25; GLONASS, which broadcasts none, assumed."""
    zenith_ionosphere: float = 0.5  # what every model leaves of the vertical delay [m]; assumed
    ionosphere_share: float = 0.35  # of the delay that a model gives [1]: "at least 50 %" right, IS-GPS-200
    ionosphere_night: float = 1.498  # vertical delay that such a share is of at least: 5 ns
    ionosphere_none: float = 3.0  # vertical delay without a model [m]; assumed
    ionosphere_decay: float = (
        3e6  # distance at which its errors have lost all but 1/e of correlation [m]; assumed
    )
    zenith_troposphere: float = 0.1  # what a model leaves of the vertical delay [m]; half of [47]
    code: float = 0.5  # noise of the code of the first band at 45 dB-Hz [m]: RTCA DO-229D class 1, [46]
    code_systems: tuple[float, float, float, float] = (1.0, 1.5, 0.6, 1.0)
    """Ratio by system [1]: [45]; Galileo 3^-0.5: the correlation of BOC(1,1) is three times as steep."""
    code_floor: float = 0.85
    """Part of its variance that does not fall with C/N0 [1]: the rest is the thermal noise of a code loop of
    0.1 Hz and 0.25 chip at 45 dB-Hz, 0.18 m by eq. 5.23 of Kaplan and Hegarty (2006)."""
    multipath_zenith: float = 0.13  # [m], [46]: 0.13 + 0.53 exp(-el / 10 deg)
    multipath_horizon: float = 0.53  # [m]
    multipath_decay: float = float(np.deg2rad(10.0))  # [rad]
    doppler: float = 0.05  # range rate [m/s], [47], example of a filter without INS
    second_band: float = 1.0  # ratio of the code noise of the second band to the first [1]


GROUND = ErrorBudget()

_NOMINAL = (2.4, 2.4, 3.2, 2.4)
"""Accuracy that a sound satellite states [m], by system: URA 0, up to 2.4 m, IS-GPS-200, 20.3.3.3.1.3;
SISA 107, 3.12 m, of all healthy Galileo satellites; the URA of BeiDou as that of GPS."""
_OF_STATED = 0.5  # error over a stated accuracy that is not the nominal one [1]; assumed
_OLD_BEIDOU = 16  # last number of BeiDou-2
_STRENGTH = 45.0  # C/N0 of the code noise in a budget [dB-Hz]


@dataclass(frozen=True, slots=True)
class Processing:
    """Settings with which a receiver computes its fixes."""

    systems: str = "all"  # as :func:`parse_systems` takes it
    ionosphere: Ionosphere = "klobuchar"
    troposphere: Troposphere = "saastamoinen"
    mapping: Mapping = "do-229"
    weather: SurfaceAir = STANDARD
    mask: float = float(np.deg2rad(10.0))  # lowest elevation used [rad]
    false_alarm: float = 5e-3  # chance of a false alarm of an epoch [1]; 0: no fault exclusion
    robust: bool = False  # less weight for large residuals
    without: frozenset[str] = frozenset()  # of CORRECTIONS
    budget: ErrorBudget = GROUND
    level: tuple[float, float, float] | None = None  # broadcast by Galileo, for "ntcm-g"
    day: float = 28.0  # of the year, for "ntcm-g" and "unb3m"


def estimate_space_sd(system: IntArray, sat: IntArray, stated: FloatArray, budget: ErrorBudget) -> FloatArray:
    """Return the sd of ephemeris and satellite clock (K,) [m].

    ``stated`` (K,) is the URA or SISA of the message [m], 0 or NaN if it has none. It is a bound, the same
    for all sound satellites, which have the error of their system; one that states more has half of that.
    """
    typical = np.array(budget.space)[system]
    typical[(system == BEIDOU) & (sat <= _OLD_BEIDOU)] = budget.space_beidou_2
    worse = np.where(stated > np.array(_NOMINAL)[system], _OF_STATED * stated, 0.0)
    return np.asarray(np.maximum(typical, worse))


def estimate_code_sd(system: IntArray, cn0: FloatArray, budget: ErrorBudget) -> FloatArray:
    """Return the noise of the code (K,) [m]; a part of its variance falls with C/N0 [dB-Hz], if known."""
    loss = 10.0 ** ((_STRENGTH - np.where(np.isfinite(cn0), cn0, _STRENGTH)) / 10.0)
    weak = budget.code_floor + (1.0 - budget.code_floor) * loss
    return np.asarray(budget.code * np.array(budget.code_systems)[system] * np.sqrt(weak))
