"""State matrices and modes of the 747 from Etkin's derivative table, by the book's equations.

B. Etkin, L. D. Reid, *Dynamics of Flight: Stability and Control*, 3rd ed. (1996), chapters 4 and 6: small
disturbances from steady level flight, stability axes. Shares nothing with the JSBSim model but the condition.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

G = 9.80665  # [m/s^2]
U = 235.9  # [m/s]
RHO = 0.3045  # [kg/m^3]
W = 2.83176e6  # [N]
S, C, B = 511.0, 8.324, 59.64  # [m^2, m, m]
IXX, IYY, IZZ, IXZ = 0.247e8, 0.449e8, 0.673e8, -0.212e7  # stability axes [kg m^2]
CL0 = 0.654
CD0 = 0.043

LONGITUDINAL = {
    "CXu": -0.1080, "CXa": 0.2193, "CZu": -0.1060, "CZa": -4.92, "CZq": -5.921, "CZad": 5.896,
    "Cmu": 0.1043, "Cma": -1.023, "Cmq": -23.92, "Cmad": -6.314,
}  # fmt: skip
LATERAL = {
    "CYb": -0.8771, "CYp": 0.0, "CYr": 0.0, "Clb": -0.2797, "Clp": -0.3295, "Clr": 0.304,
    "Cnb": 0.1946, "Cnp": -0.04073, "Cnr": -0.2737,
}  # fmt: skip
CONTROLS = {
    "CZde": -0.3648, "Cmde": -1.444, "Clda": 0.01368, "Cldr": 0.006976, "Cnda": 0.0001973,
    "Cndr": -0.1257, "CYdr": 0.1146,
}  # fmt: skip
"""Signs of the aileron as here: positive rolls right."""


def longitudinal(table: Mapping[str, float] = LONGITUDINAL) -> NDArray[np.float64]:
    """(4, 4) for u, w [m/s], q [rad/s], pitch [rad]."""
    d, m = table, W / G
    q_u = RHO * U * S / 2  # the table differentiates by u/U and w/U
    CW = CL0
    Xu, Xw = q_u * d["CXu"], q_u * d["CXa"]
    Zu, Zw = q_u * (d["CZu"] - 2 * CW), q_u * d["CZa"]
    Zq, Zwd = q_u * C / 2 * d["CZq"], q_u * C / (2 * U) * d["CZad"]
    Mu, Mw = q_u * C * d["Cmu"], q_u * C * d["Cma"]
    Mq, Mwd = q_u * C**2 / 2 * d["Cmq"], q_u * C**2 / (2 * U) * d["Cmad"]
    z = m - Zwd
    wdot = np.array([Zu, Zw, Zq + m * U, 0.0]) / z
    qdot = (np.array([Mu, Mw, Mq, 0.0]) + Mwd * wdot) / IYY
    return np.array([[Xu / m, Xw / m, 0.0, -G], wdot, qdot, [0.0, 0.0, 1.0, 0.0]])


def lateral(table: Mapping[str, float] = LATERAL) -> NDArray[np.float64]:
    """(4, 4) for v [m/s], p, r [rad/s], roll [rad]."""
    d, m = table, W / G
    q_u = RHO * U * S / 2
    Y = q_u * np.array([d["CYb"], d["CYp"] * B / 2, d["CYr"] * B / 2, 0.0])
    L = q_u * B * np.array([d["Clb"], d["Clp"] * B / 2, d["Clr"] * B / 2, 0.0])
    N = q_u * B * np.array([d["Cnb"], d["Cnp"] * B / 2, d["Cnr"] * B / 2, 0.0])
    pdot, rdot = np.linalg.solve([[IXX, -IXZ], [-IXZ, IZZ]], [L, N])
    return np.array([Y / m + [0.0, 0.0, -U, G], pdot, rdot, [0.0, 1.0, 0.0, 0.0]])


def modes(longitudinal: NDArray[np.float64], lateral: NDArray[np.float64]) -> dict[str, complex]:
    """Short period, phugoid, Dutch roll (upper of each pair), roll and spiral."""
    slow, fast = sorted((v for v in np.linalg.eigvals(longitudinal) if v.imag > 0), key=abs)
    values = np.linalg.eigvals(lateral)
    (dutch,) = (v for v in values if v.imag > 0)
    roll, spiral = sorted(v.real for v in values if v.imag == 0)
    return {"short period": fast, "phugoid": slow, "dutch roll": dutch, "roll": roll, "spiral": spiral}
