"""How far the drift of a cut of GNSS lies above its median: ``python -m tests.tails [FLIGHTS DRAWS [NAME]]``.

Flights in moderate turbulence, each with a wind and gusts of its own and cuts of 60 s. Of each filter: the
median drift, its 95 % value over the median (2.08 if all cuts were alike), and the mean of e' P^-1 e of the
horizontal error at the end of a cut (2 is right), for all cuts, for those begun straight and those in a turn.
A smoother is evaluated in the middle of a cut, where it knows least; tight coupling flies with satellites.
"""

from __future__ import annotations

import sys

import numpy as np

import bench
from bench.io.config import read_profile

CUT = 60.0  # [s]
STARTS = (90.0, 210.0, 330.0, 450.0)  # [s]
FILTERS = ("loose-15", "loose-22", "loose-full", "tight", "smoother", "ukf")
RECEIVERS = {"tight": "sky-l1"}
WORST = {"smoother": 0.5 * CUT}  # where in a cut the error is taken, if not at its end [s]
PROFILES = ("turbulent-loiter", "figure-eight")
MOST = 3.0  # 95 % of the drift over its median
TURNING = np.deg2rad(3.0)  # turn rate over the 5 s before a cut [rad/s]


def spread(drift: np.ndarray) -> float:
    """Return the 95 % value of a drift over its median."""
    return float(np.quantile(drift, 0.95) / np.median(drift))


def cuts(flights: int, draws: int, name: str) -> np.ndarray:
    """Return drift [m], e' P^-1 e, and whether it began in a turn (cuts, 3) of a filter."""
    found: list[tuple[float, float, bool]] = []
    for flight in range(flights):
        outages = [{"start_s": start, "duration_s": CUT} for start in STARTS]
        profile = read_profile(
            PROFILES[flight % len(PROFILES)],
            {
                "seed": 4000 + flight,
                "rate_hz": 100,
                "wind.from_deg": 47.0 * flight % 360.0,
                "wind.turbulence": "moderate",
                "gnss_outage": outages,
                **({"sensors.gnss": RECEIVERS[name]} if name in RECEIVERS else {}),
            },
        )
        truth = bench.fly(profile)
        heading = np.unwrap(np.arctan2(truth.vel_n[:, 1], truth.vel_n[:, 0]))
        for draw in range(draws):
            sensed = bench.sense(profile, truth, run=draw)
            solution = bench.run_filter(name, sensed.data, sensed.initial)
            errors, _ = bench.evaluate(profile, truth, solution)
            for start in STARTS:
                end = int(np.searchsorted(errors.t, start + WORST.get(name, CUT) - 0.05)) - 1
                e, P = errors.pos_n[end, :2], solution.cov[end, :2, :2]
                before = np.searchsorted(truth.t, [start - 5.0, start])
                turn = abs(np.diff(heading[before])[0]) / 5.0 > TURNING
                found.append((float(np.hypot(*e)), float(e @ np.linalg.solve(P, e)), bool(turn)))
    return np.array(found, float)


if __name__ == "__main__":
    count, draws = (int(word) for word in sys.argv[1:3] or ("12", "12"))
    for name in sys.argv[3:] or FILTERS:
        rows = cuts(count, draws, name)
        drift, ratio, turning = rows.T
        parts = "".join(
            f"; begun {words}: {part.sum()} cuts, {np.median(drift[part]):.1f} m, {ratio[part].mean():.2f}"
            for words, part in (("straight", turning == 0), ("in a turn", turning == 1))
            if part.any()
        )
        print(
            f"{name}: {len(drift)} cuts, median {np.median(drift):.1f} m, 95 % over median "
            f"{spread(drift):.2f}, e'P^-1e {ratio.mean():.2f}{parts}",
            flush=True,
        )
