"""Motion constraints of a vehicle: the velocity that wheels or wings do not allow is measured as zero.

The velocity of the axle is ``u = C' v_n + w x l``, b, with l the axle as seen from the IMU; that of an
aircraft through the air is ``u = C' (v_n - wind - gust)``. Either moves along an axis turned from the forward
axis of b by a yaw and a pitch,

    yaw   = axis_yaw   + slip_yaw (1 + |side|)
    pitch = axis_pitch + slip_pitch + pitch_by_force push

with push the forward force on a vehicle or the change of the load on wings, and side the sideways force on
tyres over `SLIP_FORCE`. ``c`` of component 0, 1, 2 is that axis, that to its right and that below, in b.

Roads, tyres and suspension err for seconds, not for samples. What lasts is in the states above; what is left
is the shaking of the axle, whose correlation of a tenth of a second the interval of the samples outlives. Air
is felt once a second: its gusts last for seconds, too, and are states.
"""

from __future__ import annotations

import numpy as np

from bench.core.compilation.compiled import inner
from bench.core.mathematics.arrays import BoolArray, FloatArray, IntArray
from bench.core.mathematics.units import STANDARD_GRAVITY
from bench.core.records.data import ImuData
from bench.navigation.engine.imu_sampler import ImuSampler, sum_segments
from bench.navigation.error_state_filter.error_state import GYRO, PHI, VEL
from bench.navigation.error_state_filter.propagation import Site
from bench.navigation.mechanization import matrix_kernel

SLIP_FORCE = 1.5  # specific force at which tyres slip twice as much; 7.5 times at 1 g [m/s^2]
INTERVAL = 0.2  # of the samples; two correlation times of a shaking axle [s]
AIR_INTERVAL = 1.0  # of the samples in flight [s]
RATE_SPAN = 0.1  # over which a rate is averaged [s]
LEAN = 0.5  # time in which tyres and suspension follow the force [s]
SHAKING_SD = 0.05  # of the velocity of an axle on a paved road, sideways and vertical [m/s]
AIR_SD = 0.3  # of the velocity through the air, sideways and along the third axis: gusts below a second [m/s]


class VehicleSampler(ImuSampler):
    """Samples the motion of a vehicle at the ends of intervals of `INTERVAL`, ``flying`` of `AIR_INTERVAL`.

    Values are, as measured, the mean rate [rad/s] and force [m/s^2], b, over `RATE_SPAN`, and of the mean
    force over `LEAN` the push [m/s^2] and the side [1].
    """

    def __init__(self, start: float, *, flying: bool) -> None:
        super().__init__(start, AIR_INTERVAL if flying else INTERVAL)
        self.flying = flying

    def measure(self, imu: ImuData, last: IntArray) -> tuple[BoolArray, FloatArray, FloatArray]:
        """Return a mask of all samples, their values (W, 8) and the variances (6,)."""

        def mean(increment: FloatArray, span: float) -> FloatArray:
            first = np.searchsorted(imu.t, imu.t[last] - span + 1e-6)
            total = sum_segments(np.column_stack([imu.dt, increment]), first, last + 1)
            return np.asarray(total[:, 1:] / total[:, :1])

        force = mean(imu.dvel_b, LEAN)
        push = force[:, 2] + STANDARD_GRAVITY if self.flying else force[:, 0]
        side = np.zeros(len(last)) if self.flying else force[:, 1] / SLIP_FORCE
        white = AIR_SD if self.flying else SHAKING_SD
        motion_b = np.column_stack([mean(imu.dtheta_b, RATE_SPAN), mean(imu.dvel_b, RATE_SPAN), push, side])
        return np.ones(len(last), np.bool_), motion_b, np.full(6, white**2)

    def first_needed(self, imu: ImuData, last: IntArray) -> int:
        """Return the first sample that the next mean may contain."""
        return int(np.searchsorted(imu.t, imu.t[-1] - LEAN))


@inner
def along_kernel(component: int, push: float, side: float, site: Site, H: FloatArray) -> float:
    """Return a component of the velocity along the vehicle [m/s], and fill its row H (n,).

    A layout without a vehicle has its axle at the IMU and its axes in b. The rate is that of ``work.motion``,
    less the rotation of the Earth, which is neglected: 1e-4 m/s.
    """
    now, _, index, _, work = site
    state, at, axle, gust, C = now.state, index.axis_yaw, index.axle_b, index.gust_n, work.C
    u, c, lever, v, w = work.vectors[0], work.vectors[1], work.vectors[2], work.vectors[3], work.motion[0]
    matrix_kernel(state, C)
    yaw, pitch, slipping = 0.0, 0.0, 1.0 + abs(side)
    for i in range(3):
        lever[i] = state[axle + 1 + i] if axle >= 0 else 0.0
        v[i] = state[3 + i]
        if gust >= 0:
            v[i] -= state[gust + 1 + i]
            if i < 2:
                v[i] -= state[index.wind_north + 1 + i]
    if at >= 0:
        yaw = state[at + 1] + state[at + 3] * slipping
        pitch = state[at + 2] + state[at + 4] + state[at + 5] * push
    sy, cy, sp, cp = np.sin(yaw), np.cos(yaw), np.sin(pitch), np.cos(pitch)
    for i in range(3):
        j, k = (i + 1) % 3, (i + 2) % 3
        u[i] = C[0, i] * v[0] + C[1, i] * v[1] + C[2, i] * v[2]
        u[i] += w[j] * lever[k] - w[k] * lever[j]
    forward = cp * (cy * u[0] + sy * u[1]) - sp * u[2]
    right = cy * u[1] - sy * u[0]
    down = sp * (cy * u[0] + sy * u[1]) + cp * u[2]
    if component == 0:
        c[0], c[1], c[2] = cy * cp, sy * cp, -sp
        along, by_yaw, by_pitch = forward, cp * right, -down
    elif component == 1:
        c[0], c[1], c[2] = -sy, cy, 0.0
        along, by_yaw, by_pitch = right, -cy * u[0] - sy * u[1], 0.0
    else:
        c[0], c[1], c[2] = cy * sp, sy * sp, cp
        along, by_yaw, by_pitch = down, sp * right, forward
    for i in range(3):
        H[VEL + i] = C[i, 0] * c[0] + C[i, 1] * c[1] + C[i, 2] * c[2]
    for i in range(3):
        j, k = (i + 1) % 3, (i + 2) % 3
        H[PHI + i] = H[VEL + j] * v[k] - H[VEL + k] * v[j]  # C c x v
        H[GYRO + i] = c[j] * lever[k] - c[k] * lever[j]
        if axle >= 0:
            H[axle + i] = c[j] * w[k] - c[k] * w[j]
        if gust >= 0:
            H[gust + i] = -H[VEL + i]
            if i < 2:
                H[index.wind_north + i] = -H[VEL + i]
    if at >= 0:
        H[at], H[at + 2] = by_yaw, by_yaw * slipping
        H[at + 1], H[at + 3], H[at + 4] = by_pitch, by_pitch, by_pitch * push
    for d in range(work.drives.shape[0]):
        H[work.drives[d, 0]] += H[work.drives[d, 1]] * work.factor[d]
    return float(along)
