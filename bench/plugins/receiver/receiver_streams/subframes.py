"""Broadcast ephemerides from the bits of navigation messages, as receivers record them.

GPS LNAV by IS-GPS-200, section 20.3.3, Galileo I/NAV by the Galileo OS SIS ICD 2.0, section 4.3.5, GLONASS by
its ICD 5.1, section 4.4, BeiDou D1 by BDS-SIS-ICD-B1I-3.0, section 5.2.4, with the tables of bits of
github.com/Orolia2s/ephemerides.
The parity is not tested: receivers pass on what passed it.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from math import pi

import numpy as np

from bench.core.records.orbit_sets import (
    BEIDOU,
    GALILEO,
    GLONASS,
    GPS,
    KEPLER,
    STATE,
    GlonassSets,
    KeplerSets,
)
from bench.core.words.exceptions import ConfigError
from bench.plugins.receiver.rinex.ephemerides import NavigationFile
from bench.plugins.receiver.rinex.lines import BEIDOU_LATE
from bench.simulation.signals.gps_time import leap_seconds, to_date
from bench.simulation.signals.orbits import DAY, WEEK

Fields = Sequence[tuple[str, int, float]]
"""Name, number of bits (negative: signed), and unit of the last bit; what has no name is passed over."""

ANGLES = ("mean_anomaly", "delta_n", "node_0", "i_0", "perigee", "node_rate", "i_rate")
"""Fields that messages have in semicircles."""
_ALPHA_BETA: Fields = [
    *((f"alpha_{k}", -8, 2.0**p) for k, p in enumerate((-30, -27, -24, -24))),
    *((f"beta_{k}", -8, 2.0**p) for k, p in enumerate((11, 14, 16, 16))),
]
LNAV: Mapping[int, Fields] = {
    1: [("", 12, 1), ("ura", 4, 1), ("health", 6, 1), ("", 90, 1), ("group_delay", -8, 2**-31),
        ("issue", 8, 1), ("t_oc", 16, 16), ("af_2", -8, 2**-55), ("af_1", -16, 2**-43),
        ("af_0", -22, 2**-31)],
    2: [("issue", 8, 1), ("c_rs", -16, 2**-5), ("delta_n", -16, 2**-43), ("mean_anomaly", -32, 2**-31),
        ("c_uc", -16, 2**-29), ("e", 32, 2**-33), ("c_us", -16, 2**-29), ("sqrt_a", 32, 2**-19),
        ("t_oe_week", 16, 16)],
    3: [("c_ic", -16, 2**-29), ("node_0", -32, 2**-31), ("c_is", -16, 2**-29), ("i_0", -32, 2**-31),
        ("c_rc", -16, 2**-5), ("perigee", -32, 2**-31), ("node_rate", -24, 2**-43), ("issue", 8, 1),
        ("i_rate", -14, 2**-43)],
    4: [("", 2, 1), ("page", 6, 1), *_ALPHA_BETA],
}  # fmt: skip
"""Subframe -> fields behind its first two words, without parity."""
INAV: Mapping[int, Fields] = {
    1: [("issue", 10, 1), ("t_oe_week", 14, 60), ("mean_anomaly", -32, 2**-31), ("e", 32, 2**-33),
        ("sqrt_a", 32, 2**-19)],
    2: [("issue", 10, 1), ("node_0", -32, 2**-31), ("i_0", -32, 2**-31), ("perigee", -32, 2**-31),
        ("i_rate", -14, 2**-43)],
    3: [("issue", 10, 1), ("node_rate", -24, 2**-43), ("delta_n", -16, 2**-43), ("c_uc", -16, 2**-29),
        ("c_us", -16, 2**-29), ("c_rc", -16, 2**-5), ("c_rs", -16, 2**-5), ("sisa", 8, 1)],
    4: [("issue", 10, 1), ("sat", 6, 1), ("c_ic", -16, 2**-29), ("c_is", -16, 2**-29), ("t_oc", 14, 60),
        ("af_0", -31, 2**-34), ("af_1", -21, 2**-46), ("af_2", -6, 2**-59)],
    5: [("a_0", 11, 2**-2), ("a_1", -11, 2**-8), ("a_2", -14, 2**-15), ("", 5, 1),
        ("group_delay", -10, 2**-32), ("group_delay_2", -10, 2**-32), ("", 2, 1), ("sick", 2, 1), ("", 1, 1),
        ("unsure", 1, 1)],
}  # fmt: skip
"""Word type -> fields behind the type."""
D1: Mapping[int, Fields] = {
    1: [("sick", 1, 1), ("", 5, 1), ("ura", 4, 1), ("", 13, 1), ("t_oc", 17, 8), ("group_delay", -10, 1e-10),
        ("group_delay_2", -10, 1e-10), ("", 64, 1), ("af_2", -11, 2**-66), ("af_0", -24, 2**-33),
        ("af_1", -22, 2**-50)],
    2: [("delta_n", -16, 2**-43), ("c_uc", -18, 2**-31), ("mean_anomaly", -32, 2**-31), ("e", 32, 2**-33),
        ("c_us", -18, 2**-31), ("c_rc", -18, 2**-6), ("c_rs", -18, 2**-6), ("sqrt_a", 32, 2**-19),
        ("t_oe_high", 2, 2**18)],
    3: [("t_oe_low", 15, 8), ("i_0", -32, 2**-31), ("c_ic", -18, 2**-31), ("node_rate", -24, 2**-43),
        ("c_is", -18, 2**-31), ("i_rate", -14, 2**-43), ("node_0", -32, 2**-31), ("perigee", -32, 2**-31)],
}  # fmt: skip
"""Subframe -> fields behind preamble, number and second of week (38 bits), without parity."""
FDMA: Mapping[int, Fields] = {
    k: [*head, (f"v{axis}", -24, 1e3 * 2**-20), (f"a{axis}", -5, 1e3 * 2**-30), (axis, -27, 1e3 * 2**-11)]
    for k, axis, head in (
        (1, "x", [("", 16, 1)]),
        (2, "y", [("sick", 1, 1), ("", 3, 1), ("t_b", 7, 900), ("", 5, 1)]),
        (3, "z", [("", 1, 1), ("clock_rate", -11, 2**-40), ("", 3, 1), ("unsure", 1, 1)]),
    )
} | {4: [("clock", -22, -(2**-30))]}  # fmt: skip
"""String -> fields behind its number; the signed ones are a sign and a size."""
FNAV = 4
"""F/NAV of Galileo, beside the codes of the systems."""
_LIMITS = {GPS: (4900.0, 5400.0), GALILEO: (5050.0, 5600.0), BEIDOU: (5000.0, 6700.0)}  # of sqrt_a [sqrt(m)]
_NEEDED = {GPS: (1, 2, 3), GLONASS: (1, 2, 3, 4), GALILEO: (1, 2, 3, 4, 5), BEIDOU: (1, 2, 3)}
_FRAME = 35.0  # from one part of a frame to the next one, at most [s]: receivers note times coarsely
MOSCOW = 10800.0
"""Time of Moscow minus UTC [s]."""
_NO_ACCURACY = {GPS: 15, GALILEO: 255, BEIDOU: 15}  # index that says so


def decode(bits: int, width: int, fields: Fields, *, magnitude: bool = False) -> dict[str, float]:
    """Return the fields at the begin of so many bits; ``magnitude``: signed ones are a sign and a size."""
    found, at = {}, width
    for name, count, unit in fields:
        size = abs(count)
        at -= size
        value = bits >> at & ((1 << size) - 1)
        sign = value >> (size - 1) if count < 0 else 0
        if sign:
            value = -(value & ((1 << (size - 1)) - 1)) if magnitude else value - (1 << size)
        if name:
            found[name] = value * unit * (pi if name in ANGLES else 1.0)
    return found


def find_ura(system: int, index: float) -> float:
    """Return the accuracy of a URA or SISA index [m]; IS-GPS-200, 20.3.3.3.1.3, OS SIS ICD 2.0, table 89."""
    if system != GALILEO:
        return float(2.0 ** (1 + index / 2 if index <= 6 else index - 2))
    steps = [(0, 0.0, 0.01), (50, 0.5, 0.02), (75, 1.0, 0.04), (100, 2.0, 0.16)]
    first, base, step = next(one for one in reversed(steps) if index >= one[0])
    return base + step * (index - first)


class BroadcastParts:
    """The parts of navigation messages, put together to ephemerides."""

    def __init__(self) -> None:
        self._parts: dict[tuple[int, int, int], dict[int, dict[str, float]]] = {}
        self._sets: dict[int, list[list[float]]] = {k: [] for k in (*_NEEDED, FNAV)}
        self._seen: set[tuple[float, ...]] = set()
        self._klobuchar: list[float] | None = None
        self._level: list[float] | None = None

    def add(self, source: tuple[int, int, int], number: int, found: dict[str, float], near: float) -> None:
        """Take a part of a message.

        Parameters
        ----------
        source : (int, int, int)
            System, satellite, and the signal.
        number : int
            That of the subframe, the type of the word, or that of the string.
        found : dict
            Its fields, and ``channel`` of GLONASS.
        near : float
            Time of reception, to a minute [s since 1980-01-06].
        """
        system, sat, _ = source
        if system == GPS and number == 4:
            if found["page"] == 56:  # the data of page 18
                self._klobuchar = [found[name] for name, *_ in _ALPHA_BETA]
            return
        if system == GALILEO and number == 5:
            self._level = [found["a_0"], found["a_1"], found["a_2"]]
        parts, needed = self._parts.setdefault(source, {}), _NEEDED[system]
        if system in (GLONASS, BEIDOU):  # without an issue: one frame
            follows = number - 1 in parts and near - parts[number - 1]["near"] < _FRAME
            if number == 1 or not follows:
                parts.clear()
            if number > 1 and not follows:
                return
        parts[number] = found | {"near": near}
        issues = {part["issue"] for part in parts.values() if "issue" in part}
        if any(k not in parts for k in needed) or len(issues) > 1:
            return
        self.add_whole(system, sat, {name: value for k in needed for name, value in parts[k].items()}, near)

    def add_whole(self, which: int, sat: int, whole: dict[str, float], near: float) -> None:
        """Take the fields of an ephemeris of a system, or `FNAV`, and a time near it [s since 1980-01-06]."""
        make = _make_state if which == GLONASS else _make_kepler
        row = make(whole, GALILEO if which == FNAV else which, sat, near)
        if row is not None and (which, *row) not in self._seen:
            self._seen.add((which, *row))
            self._sets[which].append(row)

    def make_file(self, shown: str, wanted: str, advice: str = "") -> NavigationFile:
        """Return the ephemerides found; if there is none, raise ConfigError with the ``wanted`` messages."""
        if not any(self._sets.values()):
            usual = "; give the navigation file of the day, too: bench fixes OBS NAV"
            raise ConfigError(f"{shown}: has no {wanted} in it{advice or usual}")
        g = np.array(self._sets[GLONASS]).reshape(-1, 3 + len(STATE))
        whole = [g[:, k].astype(np.int64) for k in (0, 2)]
        return NavigationFile(
            shown=shown,
            gps=self._join(GPS),
            glonass=GlonassSets(whole[0], g[:, 1] == 0, whole[1], np.ascontiguousarray(g[:, 3:])),
            klobuchar=None if self._klobuchar is None else np.array(self._klobuchar),
            galileo=(self._join(GALILEO, "I/NAV"), self._join(FNAV, "F/NAV")),
            beidou=self._join(BEIDOU),
            level=None if self._level is None else np.array(self._level),
        )

    def _join(self, system: int, message: str = "") -> KeplerSets:
        rows = np.array(self._sets[system]).reshape(-1, 2 + len(KEPLER))
        system = GALILEO if system == FNAV else system
        return KeplerSets(rows[:, 0].astype(np.int64), rows[:, 1] == 0, rows[:, 2:], system, message)


def _make_kepler(whole: dict[str, float], system: int, sat: int, near: float) -> list[float] | None:
    """Return satellite, health and ``KEPLER`` of an ephemeris; None if it is none of such an orbit."""
    late = BEIDOU_LATE if system == BEIDOU else 0.0
    if system == BEIDOU:
        whole["t_oe_week"] = whole["t_oe_high"] + whole.get("t_oe_low", 0.0)
    low, high = _LIMITS[system]
    level = system == BEIDOU and "t_oe_low" not in whole  # it may be geostationary, which D1 never is
    least = 0.0 if level else 0.6
    if not (low <= whole["sqrt_a"] <= high and whole["e"] <= 0.2 and least <= whole["i_0"] <= 1.3):
        return None
    if whole["t_oe_week"] >= WEEK or whole["t_oc"] >= WEEK or whole.get("sat", sat) != sat:
        return None
    index = whole.get("ura", whole.get("sisa", 0.0))
    unknown = index >= _NO_ACCURACY[system]
    sick = sum(whole.get(name, 0.0) for name in ("health", "sick", "unsure")) + unknown
    whole["accuracy"] = 0.0 if unknown else find_ura(system, index)
    for name, second in (("t_oe", whole["t_oe_week"]), ("t_oc", whole["t_oc"])):
        whole[name] = second + WEEK * round((near - late - second) / WEEK) + late
    return [sat, sick, *(whole.get(name, 0.0) for name in KEPLER)]


def _make_state(whole: dict[str, float], system: int, sat: int, near: float) -> list[float] | None:
    """Return slot, health, channel and ``STATE`` of GLONASS; None if it is no such orbit."""
    if not 24e6 <= np.sqrt(whole["x"] ** 2 + whole["y"] ** 2 + whole["z"] ** 2) <= 27e6:
        return None
    second = whole["t_b"] - MOSCOW + leap_seconds(to_date(near))
    whole["t_b"] = second + DAY * round((near - second) / DAY)
    sick = whole["sick"] + whole["unsure"]
    return [sat, sick, whole.get("channel", 0.0), *(whole[name] for name in STATE)]
