"""Sets of orbits and clocks of satellites as they are broadcast: Keplerian elements, GLONASS state vectors.

Times are GPS time in seconds since an origin that the caller chooses.
"""

from __future__ import annotations

from dataclasses import dataclass

from bench.arrays import BoolArray, FloatArray, IntArray

KEPLER = (
    "t_oe", "t_oe_week", "t_oc", "sqrt_a", "e", "i_0", "i_rate", "node_0", "node_rate", "perigee",
    "mean_anomaly", "delta_n", "c_uc", "c_us", "c_rc", "c_rs", "c_ic", "c_is", "af_0", "af_1", "af_2",
    "group_delay",
)  # fmt: skip
"""Columns of ``KeplerSets.elements``: IS-GPS-200 table 20-III in SI and radians.

``t_oe`` and ``t_oc`` count from the origin, ``t_oe_week`` from the start of the GPS week; ``group_delay``
is T_GD [s]. Elements that a YUMA almanac does not have are 0.
"""

GLONASS = ("t_b", "x", "y", "z", "vx", "vy", "vz", "ax", "ay", "az", "clock", "clock_rate")
"""Columns of ``GlonassSets.state``: reference time, state [m, m/s], luni-solar acceleration [m/s^2],
-tau_n [s], gamma_n [1]; PZ-90 axes."""


@dataclass(frozen=True, slots=True)
class KeplerSets:
    """Keplerian ephemerides of GPS, or of any satellite on an elliptic orbit."""

    sat: IntArray  # (E,) number within the system
    healthy: BoolArray  # (E,)
    elements: FloatArray  # (E, len(KEPLER))

    def __len__(self) -> int:
        return len(self.sat)

    @property
    def t(self) -> FloatArray:
        """Reference time of each set [s]."""
        return self.elements[:, 0]

    def shift_origin(self, origin: float) -> KeplerSets:
        """Return the same sets with times since ``origin`` [s]."""
        elements = self.elements.copy()
        elements[:, [0, 2]] -= origin
        return KeplerSets(self.sat, self.healthy, elements)


@dataclass(frozen=True, slots=True)
class GlonassSets:
    """State vectors as broadcast by GLONASS."""

    sat: IntArray  # (E,) slot
    healthy: BoolArray  # (E,)
    channel: IntArray  # (E,) frequency number, -7 to 6
    state: FloatArray  # (E, len(GLONASS))

    def __len__(self) -> int:
        return len(self.sat)

    @property
    def t(self) -> FloatArray:
        """Reference time of each set [s]."""
        return self.state[:, 0]

    def shift_origin(self, origin: float) -> GlonassSets:
        """Return the same sets with times since ``origin`` [s]."""
        state = self.state.copy()
        state[:, 0] -= origin
        return GlonassSets(self.sat, self.healthy, self.channel, state)
