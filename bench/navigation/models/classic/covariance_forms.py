"""The estimate of the 22 states and its covariance, in each form of the step and of the update.

`FilterLoop` says what moves (Phi, Q) and what was measured (Y, H, R); a form keeps x (22,) and P (22, 22) as
it likes, in double or single precision: P itself, a square root of it, or U and D. The answers are the same
to rounding. R is diagonal, so that roots take a row at a time (A-5.4.8R).
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import DTypeLike

from bench.core.mathematics.arrays import FloatArray
from bench.navigation.engine.session import Kept, Scratch, SessionState
from bench.navigation.models.classic import square_root
from bench.navigation.models.classic.navigator import Nav
from bench.navigation.models.classic.observation_model import pseudo_inverse
from bench.navigation.models.classic.square_root import Floats
from bench.navigation.options import ClassicOptions


class Form(SessionState, ABC):
    """Methods of every form; ``x`` is the estimate (n,), in the precision of the form."""

    x: Kept[Floats]

    def __init__(self, P: FloatArray, dtype: DTypeLike) -> None:
        self.x = np.zeros(len(P), dtype)

    @property
    @abstractmethod
    def covariance(self) -> FloatArray:
        """The covariance (n, n)."""

    @abstractmethod
    def predict(self, Phi: FloatArray, Q: FloatArray, T: float) -> None:
        """Step x and P over T [s] (A-5.4.4)."""

    @abstractmethod
    def add(self, E: FloatArray) -> None:
        """Add E E' to P, E (n, k)."""

    @abstractmethod
    def update(self, Y: FloatArray, H: FloatArray, R: FloatArray, rows: list[int], nav: Nav) -> None:
        """Use measurements Y (m,), rows H (m, n) and noise R (m, m) (A-5.4.5).

        ``rows`` are their numbers in (A-5.4.3), and ``nav`` is the navigator whose errors x are.
        """


class WholeForm(Form):
    """P as it is; ``x`` may have a column for each of many flights."""

    P: Kept[Floats]  # (n, n)

    def __init__(self, P: FloatArray, dtype: DTypeLike = np.float64) -> None:
        super().__init__(P, dtype)
        self.P = P.astype(dtype)

    @property
    def covariance(self) -> FloatArray:
        """The covariance (n, n)."""
        return np.asarray(self.P, float)

    def predict(self, Phi: FloatArray, Q: FloatArray, T: float) -> None:
        """Step x and P."""
        self.x, self.P = Phi @ self.x, Phi @ self.P @ Phi.T + Q

    def add(self, E: FloatArray) -> None:
        """Add E E' to P."""
        self.P = (self.P + E @ E.T).astype(self.x.dtype)


class Joseph(WholeForm):
    """The step and the update of `filterpy`."""

    kf: Scratch[Any]  # a `filterpy.kalman.KalmanFilter`

    def __init__(self, P: FloatArray, dtype: DTypeLike) -> None:
        from filterpy.kalman import KalmanFilter

        super().__init__(P, dtype)
        self.kf = KalmanFilter(dim_x=len(P), dim_z=7)
        self.kf._I = np.eye(len(P), dtype=dtype)  # the rest keeps the type of what it is given

    def predict(self, Phi: FloatArray, Q: FloatArray, T: float) -> None:
        """Step x and P."""
        self.kf.x, self.kf.P = self.x[:, None], self.P
        self.kf.predict(F=Phi.astype(self.x.dtype), Q=Q.astype(self.x.dtype))
        self.x, self.P = self.kf.x[:, 0], self.kf.P

    def update(self, Y: FloatArray, H: FloatArray, R: FloatArray, rows: list[int], nav: Nav) -> None:
        """Use all rows at once; eight are singular and take a pseudo-inverse (A-5.4.8R)."""
        self.kf.inv = pseudo_inverse if len(rows) == 8 else np.linalg.inv
        dtype = self.x.dtype
        self.kf.x, self.kf.P = self.x[:, None], self.P
        self._use(Y[:, None].astype(dtype), H.astype(dtype), R.astype(dtype))
        self.x, self.P = self.kf.x[:, 0], self.kf.P

    def _use(self, Y: Floats, H: Floats, R: Floats) -> None:
        self.kf.update(Y, R=R, H=H)


class Conventional(Joseph):
    """P - K H P, as printed for the generic filter (B-19b): the form that the others are compared with."""

    def _use(self, Y: Floats, H: Floats, R: Floats) -> None:
        x, P = self.kf.x, self.kf.P
        K = P @ H.T @ self.kf.inv(H @ P @ H.T + R)
        self.kf.x, self.kf.P = x + K @ (Y - H @ x), P - K @ (H @ P)


class Root(Form):
    """A square root S of P, stepped as a triangle; Potter's update or Carlson's."""

    S: Kept[Floats]  # (n, n)

    def __init__(self, P: FloatArray, dtype: DTypeLike, step: Callable[..., tuple[Floats, Floats]]) -> None:
        super().__init__(P, dtype)
        self.step = step
        self.S = square_root.triangular_root(square_root.root_columns(P)).astype(dtype)

    @property
    def covariance(self) -> FloatArray:
        """The covariance (n, n)."""
        S = self.S.astype(float)
        return np.asarray(S @ S.T)

    def predict(self, Phi: FloatArray, Q: FloatArray, T: float) -> None:
        """Step x and S."""
        step = Phi.astype(self.x.dtype)
        self.x, self.S = step @ self.x, step @ self.S
        self.add(square_root.root_columns(Q))

    def add(self, E: FloatArray) -> None:
        """Add E E' to P."""
        self.S = square_root.triangular_root(np.hstack([self.S, E.astype(self.x.dtype)]))

    def update(self, Y: FloatArray, H: FloatArray, R: FloatArray, rows: list[int], nav: Nav) -> None:
        """Use a row at a time."""
        for h, z, r in zip(H.astype(self.x.dtype), Y.tolist(), np.diag(R).tolist(), strict=True):
            self.x, self.S = self.step(self.x, self.S, h, z, r)


class Factors(Form):
    """U and D of P = U D U': Thornton's step, Bierman's update."""

    U: Kept[Floats]  # (n, n)
    D: Kept[Floats]  # (n,)

    def __init__(self, P: FloatArray, dtype: DTypeLike) -> None:
        super().__init__(P, dtype)
        self.U = np.eye(len(P), dtype=dtype)
        self.D = np.zeros(len(P), dtype)
        self.add(square_root.root_columns(P))

    @property
    def covariance(self) -> FloatArray:
        """The covariance (n, n)."""
        U = self.U.astype(float)
        return np.asarray(U * self.D.astype(float) @ U.T)

    def predict(self, Phi: FloatArray, Q: FloatArray, T: float) -> None:
        """Step x, U and D."""
        G = square_root.root_columns(Q).astype(self.x.dtype)
        self.x = Phi.astype(self.x.dtype) @ self.x
        self.U, self.D = square_root.thornton(self.U, self.D, Phi.astype(self.x.dtype), G)

    def add(self, E: FloatArray) -> None:
        """Add E E' to P."""
        same = np.eye(len(self.U), dtype=self.x.dtype)
        self.U, self.D = square_root.thornton(self.U, self.D, same, E.astype(self.x.dtype))

    def update(self, Y: FloatArray, H: FloatArray, R: FloatArray, rows: list[int], nav: Nav) -> None:
        """Use a row at a time."""
        for h, z, r in zip(H.astype(self.x.dtype), Y.tolist(), np.diag(R).tolist(), strict=True):
            self.x, self.U, self.D = square_root.bierman(self.x, self.U, self.D, h, z, r)


def make_form(options: ClassicOptions, P: FloatArray) -> Form:
    """Return the form of the options with P (n, n) at the start."""
    dtype = np.float32 if options.covariance_precision == "single" else np.float64
    match options.form:
        case "joseph":
            return Joseph(P, dtype)
        case "conventional":
            return Conventional(P, dtype)
        case "ud":
            return Factors(P, dtype)
        case "potter":
            return Root(P, dtype, square_root.potter)
        case "carlson":
            return Root(P, dtype, square_root.carlson)
