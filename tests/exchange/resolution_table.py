"""The table of the guide of tracks by interval and turn: ``python -m tests.exchange.resolution_table``.

Flights of four minutes, whose turns begin and end in 3 to 6 s; fixes have 1 m of noise, north and east
each. A cell has the rms of the curve off the flight, each axis, with estimated and with told noise.
"""

from __future__ import annotations

from math import radians, tan

import numpy as np
import pymap3d

from bench.core.mathematics import earth
from bench.core.mathematics.arrays import FloatArray
from bench.core.records.flight_specs import TrackSpec
from bench.core.words.exceptions import ConfigError
from bench.io.trajectories.track_files import FixSeries
from bench.io.trajectories.track_motion import make_motion

G = 9.80665
FLIGHTS: dict[
    str, tuple[float, float, tuple[tuple[int, int], ...]]
] = {  # airspeed [m/s], bank [deg], begin and direction of each change
    "straight": (45.0, 0.0, ()),
    "half circle, 5 deg of bank, 45 m/s": (45.0, 5.0, ((60, 1), (224, -1))),
    "half circle, 25 deg, 45 m/s": (45.0, 25.0, ((60, 1), (91, -1))),
    "s-turns, 20 deg, 45 m/s": (45.0, 20.0, ((30, 1), (70, -2), (110, 2), (150, -2), (190, 2))),
    "s-turns, 30 deg, 25 m/s": (25.0, 30.0, ((30, 1), (60, -2), (90, 2), (120, -2), (150, 2), (180, -1))),
    "circles, 45 deg, 25 m/s": (25.0, 45.0, ((20, 1),)),
}
RATES = (0.2, 0.5, 1.0, 5.0, 20.0)  # [Hz]
_STEP = 0.05  # [s]


def make_flight(name: str, seconds: float = 240.0) -> FloatArray:
    """North and east (N, 2) [m] at 20 Hz."""
    speed, bank, changes = FLIGHTS[name]
    t = np.arange(0.0, seconds + _STEP / 2, _STEP)
    share = np.zeros(len(t))
    for at, by in changes:
        share += by * np.clip((t - at) / (3 + bank / 15), 0, 1)
    course = np.cumsum(G * tan(radians(bank)) / speed * share) * _STEP
    return np.asarray(np.cumsum(speed * np.column_stack([np.cos(course), np.sin(course)]), axis=0) * _STEP)


def places(way: FloatArray) -> FloatArray:
    """Latitude, longitude [rad] and height of places by pymap3d."""
    lat, lon, alt = pymap3d.ned2geodetic(*way.T, np.zeros(len(way)), 47.0, 11.0, 500.0)
    return np.column_stack([np.radians(lat), np.radians(lon), alt])


def find_off(name: str, rate: float, noise: float | None, seed: int = 1) -> float:
    """Rms of the curve off the flight, each axis [m]; ConfigError where it is rejected."""
    way = make_flight(name)
    rows = np.arange(0, len(way), round(1 / (_STEP * rate)))
    fixes = way[rows] + np.random.default_rng(seed).standard_normal((len(rows), 2))
    spec = TrackSpec(noise=noise, vertical_noise=1.0)
    motion = make_motion(FixSeries(rows * _STEP, places(fixes), ()), spec, "t")
    off = earth.difference_n(earth.to_geodetic(motion.pos_e), places(way[: len(motion.t)]))[:, :2]
    return float(np.sqrt(np.mean(off**2)))


def main() -> None:
    """Print a row for each flight."""
    print(f"| flight | {' | '.join(f'{rate:g} Hz' for rate in RATES)} |\n|---|{'---|' * len(RATES)}")
    for name in FLIGHTS:
        cells = []
        for rate in RATES:
            said = []
            for noise in (None, 1.0):
                try:
                    said.append(f"{find_off(name, rate, noise):.2g}")
                except ConfigError:
                    said.append("refused")
            cells.append(", ".join(said) + ("" if said == ["refused"] * 2 else " m"))
        print(f"| {name} | {' | '.join(cells)} |", flush=True)


if __name__ == "__main__":
    main()
