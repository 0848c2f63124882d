"""Orbits and clocks of satellites: Keplerian elements and GLONASS state vectors as broadcast, tables of SP3.

Times are GPS time in seconds since an origin that the caller chooses.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

from bench.core.mathematics.arrays import BoolArray, FloatArray, IntArray

GPS, GLONASS, GALILEO, BEIDOU = 0, 1, 2, 3
"""Codes of satellite systems; also the order of the clocks of a receiver."""

LETTERS = "GREC"
"""Letter of each system in RINEX."""

SYSTEM_NAMES = ("GPS", "GLONASS", "Galileo", "BeiDou")

_GROUPS = {"both": frozenset({GPS, GLONASS}), "all": frozenset({GPS, GLONASS, GALILEO, BEIDOU})}
_NAMED = {name.lower(): frozenset({k}) for k, name in enumerate(SYSTEM_NAMES)}
SYSTEM_CHOICES = (*_NAMED, *_GROUPS, "auto")

KEPLER = (
    "t_oe", "t_oe_week", "t_oc", "sqrt_a", "e", "i_0", "i_rate", "node_0", "node_rate", "perigee",
    "mean_anomaly", "delta_n", "c_uc", "c_us", "c_rc", "c_rs", "c_ic", "c_is", "af_0", "af_1", "af_2",
    "group_delay", "group_delay_2", "accuracy",
)  # fmt: skip
"""Columns of ``KeplerSets.elements``: IS-GPS-200 table 20-III in SI and radians.

``t_oe`` and ``t_oc`` count from the origin, ``t_oe_week`` from the start of the week of the system. Delays
[s]: T_GD of GPS; BGD E5a/E1 and BGD E5b/E1 of Galileo; T_GD1 (B1I) and T_GD2 (B2I) of BeiDou. ``accuracy`` is
the URA or SISA of the message [m], 0 if it has none. Elements that a YUMA almanac does not have are 0.
"""

STATE = ("t_b", "x", "y", "z", "vx", "vy", "vz", "ax", "ay", "az", "clock", "clock_rate")
"""Columns of ``GlonassSets.state``: reference time, state [m, m/s], luni-solar acceleration [m/s^2],
-tau_n [s], gamma_n [1]; PZ-90 axes."""


@dataclass(frozen=True, slots=True)
class KeplerSets:
    """Keplerian ephemerides of GPS, Galileo or BeiDou, or of any satellite on an elliptic orbit."""

    sat: IntArray  # (E,) number within the system
    healthy: BoolArray  # (E,)
    elements: FloatArray  # (E, len(KEPLER))
    system: int = GPS  # whose gravity, rotation of the Earth and geostationary frame apply
    message: str = ""  # "I/NAV" or "F/NAV" of Galileo: the pair of carriers that the clocks refer to

    def __len__(self) -> int:
        return len(self.sat)

    @property
    def t(self) -> FloatArray:
        """Reference time of each set [s]."""
        return self.elements[:, 0]

    def get(self, name: str) -> FloatArray:
        """Return the column (E,) of an element by its name in ``KEPLER``."""
        return self.elements[:, KEPLER.index(name)]

    def shift_origin(self, origin: float) -> KeplerSets:
        """Return the same sets with times since ``origin`` [s]."""
        elements = self.elements.copy()
        elements[:, [0, 2]] -= origin
        return KeplerSets(self.sat, self.healthy, elements, self.system, self.message)


@dataclass(frozen=True, slots=True)
class GlonassSets:
    """State vectors as broadcast by GLONASS."""

    sat: IntArray  # (E,) slot
    healthy: BoolArray  # (E,)
    channel: IntArray  # (E,) frequency number, -7 to 6
    state: FloatArray  # (E, len(STATE))

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


@dataclass(frozen=True, slots=True)
class OrbitTable:
    """Precise orbits and clocks of one system at the epochs of SP3 files; what is missing is NaN."""

    system: int
    sat: IntArray  # (S,) number within the system
    t: FloatArray  # (N,) epochs, GPS time [s]
    pos_e: FloatArray  # (S, N, 3) center of mass [m], e
    clock: FloatArray  # (S, N) without its eccentric term [s]
    sd: FloatArray  # (S, N) what the file says of its accuracy [m]; 0: nothing
    joined: BoolArray  # (S, N - 1, 2) whether orbit, clock may be interpolated between two epochs
    shown: str  # names of the files

    def __len__(self) -> int:
        return len(self.sat)

    def shift_origin(self, origin: float) -> OrbitTable:
        """Return the same table with times since ``origin`` [s]."""
        return replace(self, t=self.t - origin)


def name_satellite(system: int, sat: int) -> str:
    """Return the RINEX name of a satellite.

    Examples
    --------
    >>> name_satellite(GPS, 5), name_satellite(BEIDOU, 20)
    ('G05', 'C20')
    """
    return f"{LETTERS[system]}{sat:02d}"


def parse_systems(text: str) -> frozenset[int]:
    """Return the codes of the systems in a choice such as "gps,galileo", "both" (GPS, GLONASS), "all".

    Raises
    ------
    ValueError
        If a name is none of ``SYSTEM_CHOICES``.

    Examples
    --------
    >>> sorted(parse_systems("gps,galileo")), sorted(parse_systems("auto"))
    ([0, 2], [0, 1, 2, 3])
    """
    known = _NAMED | _GROUPS | {"auto": _GROUPS["all"]}
    found: frozenset[int] = frozenset()
    for name in text.split(","):
        if name.strip() not in known or (name.strip() == "auto" and name != text):
            choices = ", ".join(SYSTEM_CHOICES)
            raise ValueError(f"systems = {text!r} must be one of {choices}, or systems with commas between")
        found |= known[name.strip()]
    return found
