"""States of tight coupling: the receiver clock, and the time-correlated errors of the ranges."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from bench.core.records.orbit_sets import GPS, SYSTEM_NAMES
from bench.core.records.sensor_specs import AssumedSpecs
from bench.core.records.sky_spec import SkySpec
from bench.navigation.error_state_filter.ranges.ionosphere_anchors import ANCHORS
from bench.navigation.error_state_filter.state_processes import Block, States, assumed
from bench.simulation.signals.orbits import C

RANGES = (16, 12, 12, 16)
"""Satellites of each system whose range error has a state; one more than these waits until one has set.

Some 14 of 32, 10 of 24 and 10 of 27 are in view; of BeiDou 14 of 44 in Europe, 16 and more in East Asia.
"""
SYSTEMS = tuple(name.lower() for name in SYSTEM_NAMES)
_OBLIQUITY = 1.6  # of the ionosphere at 35 deg, the median elevation above 5 deg [1]
_COMBINED = 2.98  # of the ionosphere-free combination of GPS, B-11 [1]
_VERTICAL = 4.0  # delay of the ionosphere for the rate of its errors [m]: the middle of night and noon
_OWN = 0.15  # part of the variance of its errors at 35 deg that the anchors do not tell [1]


def _clock(specs: AssumedSpecs) -> list[States]:
    sky = assumed(specs, "gnss").sky
    rate = assumed(specs, "gnss").rate
    walk = 2.0 * np.pi**2 * C**2 * sky.clock_h_m2
    changed = 2.0 * (np.euler_gamma + np.log(max(np.pi / (rate * sky.integration), 1.0)))
    flicker = changed * C**2 * sky.clock_h_m1 * rate
    return [
        States("clock_offset", "m", 1, sky.clock_offset_sd**2, 0.5 * C**2 * sky.clock_h_0),
        States("clock_drift", "m_s", 1, sky.clock_drift_sd**2, walk + flicker),
        *(
            States(f"{SYSTEMS[system]}_offset", "m", 1, sky.offset_sd[system] ** 2)
            for system in sky.constellations
            if system != GPS
        ),
    ]


CLOCK = Block("tight", _clock, takes=("flicker of the receiver's clock",), records=("observations",))
"""Offset and drift of the receiver's clock, and its offset for each system beside GPS.

``c^2 h_0 / 2`` drives the offset and ``2 pi^2 c^2 h_-2`` the drift (Brown and Hwang). Flicker, h_-1, has no
state of finite size: between two epochs, T apart, the drift walks as far as flicker moves the frequency that
is measured over t: ``2 h_-1 (0.577 + ln(pi T / t))``, the integral of ``2 (1 - cos 2 pi f T) h_-1 / f`` up to
``f = 1 / 2t``. The offset grows by the drift: `propagation`.
"""


def multipath_sd(sky: SkySpec) -> tuple[float, float]:
    """Return the multipath sigma at the zenith and its increase at the horizon [m]; 0 if it is white."""
    if sky.multipath_correlation <= 1.0:
        return 0.0, 0.0
    return sky.multipath_zenith_sd, sky.multipath_horizon_sd


def _find_vertical(sky: SkySpec) -> float:
    """Return the vertical error of the ionosphere [m]."""
    return float(np.hypot(sky.ionosphere_sd, _VERTICAL * sky.ionosphere_share)) if sky.bands == 1 else 0.0


def list_range_errors(sky: SkySpec, system: int) -> tuple[float, float, float]:
    """Return the sigmas of the time-correlated errors of a range [m]: satellite, ionosphere, multipath."""
    above = float(np.sqrt(_OWN) * _OBLIQUITY * _find_vertical(sky))
    near = multipath_sd(sky)[0] * (_COMBINED if sky.bands == 2 else 1.0)
    return sky.space_sd[system], above, near


def _range_errors(specs: AssumedSpecs) -> list[States]:
    """Return unit states; their columns of H contain the size of the errors at an elevation (`ranging`)."""
    sky = assumed(specs, "gnss").sky
    vertical = _find_vertical(sky)
    times = [
        max(one, 1.0)
        for one in (sky.space_correlation, sky.ionosphere_correlation, sky.multipath_correlation)
    ]
    found: list[States] = []

    def add(name: str, decay: float, numbers: Iterable[int] = ()) -> None:
        names = [f"{name}_{k}" for k in numbers] or [name]
        found.extend(States(one, "1", 1, 1.0, decay_time=decay, stationary=1.0) for one in names)

    if vertical > 0.0:
        add("ionosphere", 1.0 / times[1], range(1, len(ANCHORS) + 1))
    if sky.troposphere_sd > 0.0:
        add("troposphere", 1.0 / max(sky.troposphere_correlation, 1.0))
    for system in sky.constellations:
        parts = np.square(list_range_errors(sky, system))
        if parts.any():
            add(
                f"{SYSTEMS[system]}_range", float(parts.sum() / (parts @ times)), range(1, RANGES[system] + 1)
            )
    return found


RANGE_ERRORS = Block(
    "tight",
    _range_errors,
    takes=(
        "satellite orbit and clock error",
        "ionosphere beyond the broadcast model",
        "troposphere beyond the model",
        "multipath",
    ),
    records=("observations",),
)
"""What wanders in the ranges: of all of them the ionosphere around the receiver and the zenith troposphere;
of each satellite orbit, clock, multipath, and what the ionosphere has more there, as one Gauss-Markov process
with the mean of their times, by their variances: what is slow must not average out.

The states of satellites are the last of a layout, and no part of an answer. One that no satellite has had is
no part of the work, either. A state goes to a satellite that rises when the one that had it is gone:
`satellite_states.Channels`.
"""
