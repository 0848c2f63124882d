"""Numbers of the register on the linear flight of section 7.1: covariances, and runs along them."""

from __future__ import annotations

from typing import get_args

import numpy as np

from bench.core.mathematics.arrays import FloatArray
from bench.core.mathematics.units import DEG
from bench.experiments.studies.linear_flight import GRADES, LOST, LinearFlight, update
from bench.navigation.models.classic import observation_model, process_model
from bench.navigation.models.classic.extrapolation import Curve, extrapolate
from bench.navigation.models.classic.process_model import Sigmas
from bench.plugins.papers.register_measures import RowFinding, below, near

_GRADE = GRADES["grade-3"]
_GROWN = {
    "grade-1": 9.2,
    "grade-2": 10.6,
    "grade-3": 27.5,
    "MEMS": 227.0,
}  # east after 300 s, section 7.1 [m]


def keep_step() -> RowFinding:
    """#20: standard deviations after 100 s from nothing, by steps of 1 and 0.1 s, van Loan."""
    flight, sd = LinearFlight(), []
    nav, a = flight.place(0.0)
    for dt in (1.0, 0.1):
        Phi, Q = process_model.model_van_loan(nav, flight.earth, a, _GRADE.sigmas, dt)
        P = np.zeros_like(Q)
        for _ in range(round(100.0 / dt)):
            P = Phi @ P @ Phi.T + Q
        sd.append(np.sqrt(np.diag(P)))
    off = float(np.abs(sd[0] / sd[1] - 1.0).max())
    return RowFinding(f"1 and 0.1 s within {100.0 * off:.2g} %", (below(off, 0.01),))


def draw_consistency(
    runs: int, seconds: int = 900, seed: int = 5, believed: Sigmas | None = None
) -> tuple[float, float]:
    """Return mean NIS and NEES over the runs of a linear flight of grade 3 with turns.

    ``believed`` are the figures of the receiver and the barometer that the filter takes for true.
    """
    rng, flight, sig = np.random.default_rng(seed), LinearFlight(), _GRADE.sigmas
    P = flight.start(_GRADE)
    x = np.sqrt(np.diag(P))[:, None] * rng.standard_normal((len(P), runs))
    estimate, nis, nees = np.zeros_like(x), [], []
    for k in range(1, seconds + 1):
        Phi, G = flight.move(sig, k)
        x = Phi @ x + G @ rng.standard_normal((process_model.NOISES, runs))
        estimate, P = Phi @ estimate, Phi @ P @ Phi.T + G @ G.T
        H, R = flight.measure(sig, k)
        z = H @ x + np.sqrt(np.diag(R))[:, None] * rng.standard_normal((len(R), runs))
        K, S, P = update(P, H, flight.measure(believed or sig, k)[1])
        innovation = z - H @ estimate
        nis.append(np.sum(innovation * np.linalg.solve(S, innovation), axis=0).mean())
        estimate = estimate + K @ innovation
        sd = np.sqrt(np.diag(P))
        error = (x - estimate) / sd[:, None]
        nees.append(np.sum(error * np.linalg.solve(P / np.outer(sd, sd), error), axis=0).mean())
    return float(np.mean(nis)), float(np.mean(nees))


def be_consistent() -> RowFinding:
    """#34: the filter with 22 states over 200 runs of 900 s."""
    nis, nees = draw_consistency(200)
    return RowFinding(f"NIS {nis:.2f}, NEES {nees:.1f}", (near(nis, 7.0, 0.1), near(nees, 22.0, 1.5)))


def count_rank() -> RowFinding:
    """#35: rank of the published eight rows, of their noise and of S."""
    H = observation_model.measurement_matrix()
    flight = LinearFlight()
    Q = observation_model.measurement_noise(_GRADE.sigmas, *flight.reduced, True)
    R = Q @ Q.T
    S = H @ flight.start(_GRADE) @ H.T + R
    ranks = [int(np.linalg.matrix_rank(one)) for one in (H, R, S)]
    same = float(np.abs(H[7] - (H[3] - H[0])).max())
    checks = (*(near(rank, 7.0, 0.0) for rank in ranks), below(same, 0.0))
    return RowFinding(f"{', '.join(map(str, ranks))} of 8; row 8 is 4 less 1", checks)


def draw_outage(runs: int = 50, known: int = 300, lost: int = 60, seed: int = 7) -> dict[str, float]:
    """Return the RMS horizontal error [m] after an outage of straight linear flights.

    That of the INS, of the prediction of the filter, and of each curve through its estimates before.
    """
    rng, flight, sig = np.random.default_rng(seed), LinearFlight(turns=False), _GRADE.sigmas
    P = flight.start(_GRADE)
    x = np.sqrt(np.diag(P))[:, None] * rng.standard_normal((len(P), runs))
    found, times, kept = np.zeros_like(x), list[float](), list[FloatArray]()
    for k in range(1, known + lost + 1):
        Phi, G = flight.move(sig, k)
        x = Phi @ x + G @ rng.standard_normal((process_model.NOISES, runs))
        found, P = Phi @ found, Phi @ P @ Phi.T + G @ G.T
        H, R = flight.measure(sig, k)
        rows = slice(0, 7 if k <= known else 1)
        H, R = H[rows], R[rows, rows]
        z = H @ x + np.sqrt(np.diag(R))[:, None] * rng.standard_normal((len(R), runs))
        K, _, P = update(P, H, R)
        found = found + K @ (z - H @ found)
        if known - 120 <= k <= known:
            times.append(float(k))
            kept.append(found[:2].copy())
    answers = {"ins": np.zeros((2, runs)), "prediction": found[:2]}
    answers |= {curve: extrapolate(curve, times, kept, float(known + lost)) for curve in get_args(Curve)}
    unit = np.array(flight.reduced)[:, None]
    return {
        name: float(np.sqrt(np.mean(np.sum(((one - x[:2]) / unit) ** 2, axis=0))))
        for name, one in answers.items()
    }


def go_on() -> RowFinding:
    """#46: error of a parabola 60 s into an outage over the error of the INS; and the prediction."""
    found = draw_outage()
    ratio, own = (found[name] / found["ins"] for name in ("parabola", "prediction"))
    text = f"parabola {ratio:.2f}, prediction {own:.2f} of the INS"
    return RowFinding(text, (below(ratio, 0.3), below(own, ratio)))


def grow() -> RowFinding:
    """#47: growth east in 300 s without GNSS by grade."""
    texts, checks = [], []
    for name, printed in _GROWN.items():
        sd = LinearFlight().predict_sd(GRADES[name], LOST + 300)[:, 0]
        grown = float(np.sqrt(sd[-1] ** 2 - sd[LOST] ** 2))
        texts.append(f"{grown:.3g}")
        checks.append(near(grown, printed, 0.15 * printed))
    return RowFinding(f"{', '.join(texts)} m after 300 s", tuple(checks))


def turn_for_heading() -> RowFinding:
    """#49: heading of grade 3 after an S-turn, and without turns."""
    after = float(LinearFlight().predict_sd(_GRADE, 400)[-1, 8]) / DEG
    straight = float(LinearFlight(turns=False).predict_sd(_GRADE, LOST)[-1, 8]) / DEG
    checks = (near(after, 0.0075, 1.5e-4), near(straight, 0.31, 6.2e-3))
    return RowFinding(f"{after:.2g} deg, {straight:.2g} without", checks)
