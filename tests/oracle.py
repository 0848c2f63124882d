"""loose-22 against classic-22 on the shipped profiles: ``make oracle`` writes the guide's table.

The two are one filter in other axes, coordinates and code, linearized at other points; both weigh a fix by
its datasheet. Left out are the profile across the pole, for the reduced coordinates of classic-22 end at
85 deg (equations 1.5), the one at rest, where loose-22 alone knows that nothing tells the heading, the one
whose jumping fixes both reject for a while, after which P depends on the epoch, and those flown by a filter.
Exit status 1 when a difference exceeds its limit.

    python -m tests.oracle                    all profiles, bench/guide/accuracy.md rewritten
    python -m tests.oracle circuit survey     only these, nothing written
"""

from __future__ import annotations

import math
import sys
import time
from pathlib import Path

import numpy as np

from bench import pipeline
from bench.core.mathematics import earth, rotation
from bench.core.records.flight_specs import FlightSpec
from bench.io.config import list_profiles, read_profile
from bench.navigation.models.classic import Classic22
from bench.navigation.models.loose_tight import Loose
from tests.measured import stamp, write_measured

LIMITS = {"position": 0.05, "velocity": 0.005, "attitude": 20e-6}  # RMS [m], [m/s], [rad]
EXEMPT = ("polar", "static", "all-sensors", "thermal-soaring")
OTHERWISE = {
    "sensors.imu": "stim300",
    "sensors.gnss": "l1-code",
    "fault": [],
    "gnss_outage": [],
    "wind.turbulence": "none",
    "alignment.kind": "given",
}
"""How a multirotor and a glider that starts at rest are compared: the errors of their own units and of an
outage are too large for two linearizations, and a touch-down in gusts is beyond the range of the IMU."""
PAGE = Path(__file__).parents[1] / "bench" / "guide" / "accuracy.md"
BEGIN, END = "<!-- make oracle writes this table -->", "<!-- to here -->"


def flies_otherwise(name: str) -> bool:
    """Return whether a profile flies a multirotor, or a glider from the ground."""
    flight = read_profile(name).flight
    if not isinstance(flight, FlightSpec):
        return False
    return flight.aircraft.hovers or (flight.aircraft.glides and flight.on_ground)


def differences(name: str) -> tuple[float, dict[str, float]]:
    """Return the length of a profile's flight [s] and the RMS differences of both filters on it."""
    profile = read_profile(name, OTHERWISE if flies_otherwise(name) else None)
    truth = pipeline.fly(profile)
    sensed = pipeline.sense(profile, truth)
    mine = Classic22().run(sensed.data, sensed.initial)
    theirs = Loose(gnss_markov=True, fix_accuracy="datasheet").run(sensed.data, sensed.initial)
    turned = rotation.to_rotvec(rotation.multiply(mine.q_nb, rotation.conjugate(theirs.q_nb)))
    apart = (earth.difference_n(mine.lla, theirs.lla), mine.vel_n - theirs.vel_n, turned)
    rms = [math.sqrt(float(np.mean(np.sum(d * d, axis=1)))) for d in apart]
    return float(truth.t[-1]), dict(zip(LIMITS, rms, strict=True))


def row(cells: list[str]) -> str:
    """Return one line of a Markdown table."""
    return f"| {' | '.join(cells)} |"


def main(names: list[str]) -> int:
    """Compare, print, and write the table when nothing was named."""
    known = [name for name, *_ in list_profiles() if name not in EXEMPT]
    known = [name for name in known if read_profile(name).guidance is None]
    unknown = sorted(set(names) - set(known))
    if unknown:
        print(
            f"error: no profile {unknown[0]!r} to compare on; there are {', '.join(known)}", file=sys.stderr
        )
        return 2
    lines = [row(["profile", "flown", "position", "velocity", "attitude"]), "|---|---|---|---|---|"]
    within = True
    for name in names or known:
        begun = time.process_time()
        length, found = differences(name)
        within &= all(found[what] <= limit for what, limit in LIMITS.items())
        mm, mm_s, microradian = (
            found[what] * scale for what, scale in zip(found, (1e3, 1e3, 1e6), strict=True)
        )
        cells = [f"{length:.0f} s", f"{mm:.2g} mm", f"{mm_s:.2g} mm/s", f"{microradian:.2g} microradian"]
        lines.append(row([f"`{name}`", *cells]))
        print(lines[-1], f"{time.process_time() - begun:.0f} s of CPU", flush=True)
    limits = [f"{1e3 * LIMITS['position']:g} mm", f"{1e3 * LIMITS['velocity']:g} mm/s"]
    lines.append(row(["allowed", "", *limits, f"{1e6 * LIMITS['attitude']:g} microradian"]))
    if not names:
        text = PAGE.read_text(encoding="utf-8")
        head, _, rest = text.partition(BEGIN)
        _, found_end, tail = rest.partition(END)
        if not found_end:
            print(f"error: {PAGE}: no lines {BEGIN!r} and {END!r} to write between", file=sys.stderr)
            return 2
        PAGE.write_text(
            "\n".join([head + BEGIN, *lines, "", write_measured([stamp()]), END]) + tail, encoding="utf-8"
        )
    print("all within the limits" if within else "a limit is exceeded")
    return 0 if within else 1


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
