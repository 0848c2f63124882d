"""Recorded gains of a compiled loose filter in one run, for covariances with these gains."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from bench.core.mathematics.arrays import FloatArray, IntArray
from bench.core.mathematics.units import SAME_INSTANT
from bench.core.records.data import Innovations, SensorData, Trajectory
from bench.core.records.run_records import Sensed
from bench.core.words.exceptions import ConfigError
from bench.evaluation.linear.path import LinearPath, make_path
from bench.navigation.engine.kalman import update_kernel
from bench.navigation.error_state_filter.antenna_rows import antenna_kernel
from bench.navigation.error_state_filter.error_state import GYRO
from bench.navigation.error_state_filter.filter_run import Nodes
from bench.navigation.error_state_filter.measurement_rows import (
    BARO,
    POSITION,
    SENSORS,
    VELOCITY,
)
from bench.navigation.error_state_filter.state_blocks import Index, StateModel, state_model
from bench.navigation.models.loose_tight import Fusion, Loose
from bench.navigation.start.turn_on import find_turn_on

KNOWN = (POSITION, VELOCITY, BARO)
"""Sensors of `bench.navigation.error_state_filter.measurement_rows` whose rows there are here."""


@dataclass(frozen=True, slots=True)
class Updates:
    """U scalar measurements in the order of use, each as the residual h dx minus the error of the sensor."""

    step: IntArray  # (U,) of the path, after which it is used
    code: IntArray  # (U,) sensor, of `KNOWN`
    component: IntArray  # (U,)
    number: IntArray  # (U,) of its record
    h: FloatArray  # (U, n)
    K: FloatArray  # (U, n) gain

    def __len__(self) -> int:
        return len(self.step)


@dataclass(frozen=True, slots=True)
class Gains:
    """One run of a filter of n states along a true motion."""

    path: LinearPath
    model: StateModel
    updates: Updates
    output: IntArray  # (M,) epochs of the path where it answered
    P: FloatArray  # (M, 9, 9) covariance that it reported there
    refused: int  # scalar measurements that it did not use


def record_gains(filter_: Fusion, sensed: Sensed, truth: Trajectory, output_t: FloatArray) -> Gains:
    """Run a filter and return its gains; answers are those at ``output_t`` (M,) [s].

    Raises
    ------
    ConfigError
        If the filter starts or measures in a way that has no rows here.
    """
    if not isinstance(filter_, Loose):
        raise ConfigError(
            "the linear model fits loose-15, loose-22, loose-mems, loose-full, baro-inertial and "
            "free-inertial; name one of these"
        )
    if sensed.initial.alignment != "given":
        raise ConfigError("the linear model needs a start that is given: alignment = 'given'")
    data = replace(sensed.data, output_t=output_t)
    if filter_.options.every_error and find_turn_on(data, sensed.initial) is not None:
        raise ConfigError(
            "loose-full learns the turn-on bias of this IMU before it starts, which has no linear model; "
            "use loose-22 or loose-mems"
        )
    solution, stretches, _ = filter_.forward(data, sensed.initial)
    nodes = _join_nodes(stretches)
    table = solution.innovations
    model = state_model(sensed.initial, data.specs, filter_.blocks_for(data))
    path = make_path(truth, data.specs.imu, nodes.t)
    used = {SENSORS[code] for code in np.unique(table.code)} - {SENSORS[code] for code in KNOWN}
    if used:
        raise ConfigError(
            f"the linear model knows fixes and barometers, not {', '.join(sorted(used))}; "
            "leave out what asks for it"
        )
    step = np.clip(np.searchsorted(path.t, nodes.t - SAME_INSTANT), 0, len(path.t) - 1)
    updates = _replay(table, nodes, step, path, model, data)
    asked = nodes.output[nodes.output >= 0]
    return Gains(path, model, updates, step[asked], nodes.P[asked, 1, :9, :9], int((~table.accepted).sum()))


def measurement_rows(
    path: LinearPath, at: int, code: int, antenna_b: FloatArray, index: Index, n: int
) -> FloatArray:
    """Return H (m, n) of a sensor at a time of the truth, but for states that add to the gyro biases."""
    if code == BARO:
        H = np.zeros((1, n))
        H[0, 2] = -1.0
        if index.baro_bias >= 0:
            H[0, index.baro_bias] = 1.0
        return H
    H, z, C = np.zeros((6, n)), np.zeros(6), path.C_nb[at]
    nav = np.zeros(10)
    nav[:3] = path.lla[at]
    antenna_kernel(nav, C, antenna_b, path.rate_b[at], nav[:3], np.zeros(3), H, z)
    if index.antenna_b >= 0:
        arm = slice(index.antenna_b, index.antenna_b + 3)
        H[:3, arm] = C
        x, y, w = path.rate_b[at]
        H[3:, arm] = C @ np.array([[0.0, -w, y], [w, 0.0, -x], [-y, x, 0.0]])
    if index.gnss_pos >= 0:
        H[:, index.gnss_pos : index.gnss_pos + 6] += np.eye(6)
    return H[:3] if code == POSITION else H[3:]


def _replay(
    table: Innovations, nodes: Nodes, step: IntArray, path: LinearPath, model: StateModel, data: SensorData
) -> Updates:
    """Return the updates of the accepted measurements, with the gains computed from P before each update.

    The variance of the noise is the logged variance of the innovation minus H P H^T. At a re-admitted
    measurement, for which P was inflated, it is the noise variance of the measurement before.
    """
    n = model.layout.size
    n_rows = len(table.t)
    new = np.ones(n_rows, np.bool_)
    new[1:] = (np.diff(table.code) != 0) | (np.diff(table.component) <= 0)
    begins = np.flatnonzero(new)
    ends = np.append(begins[1:], n_rows)[: len(begins)]
    at = np.clip(np.searchsorted(nodes.t, table.t[begins] - SAME_INSTANT), 0, len(nodes.t) - 1)
    noise: dict[tuple[int, int], float] = {}
    found: list[tuple[int, int, int, int]] = []
    h_rows, gains = [], []
    counts = dict.fromkeys(KNOWN, 0)
    node, P = -1, np.zeros((n, n))
    row, other, dx = np.zeros(n), np.zeros(n), np.zeros(n)
    numbers = {
        code: find_record_rows(table.t[begins][table.code[begins] == code], code, data) for code in KNOWN
    }
    for first, end, here in zip(begins, ends, at, strict=True):
        if here != node:
            node, P = here, nodes.P[here, 0].copy()
        code = int(table.code[first])
        H = measurement_rows(path, int(step[here]), code, data.antenna_b, model.index, n)
        seen = H.copy()
        seen[:, GYRO : GYRO + 3] = 0.0  # the rate of a lever arm is taken for known
        for state, error, by in model.process.drives:
            H[:, state] += H[:, error] * path.factors[max(int(step[here]) - 1, 0), by]
        left = table.S[first:end] - np.einsum("bi,ij,bj->b", H, P, H)
        number = int(numbers[code][counts[code]])
        counts[code] += 1
        for b in range(end - first):
            r = float(left[b])
            if not r > 0.0:
                r = noise.get((code, b), np.nan)
            noise[code, b] = r
            if not table.accepted[first + b]:
                continue
            update_kernel(P, dx, H[b], 0.0, r, row, other)
            found.append((int(step[here]), code, b, number))
            h_rows.append(seen[b])
            gains.append(other.copy())
    marks = np.array(found, np.int64).reshape(-1, 4)
    step_, code_, component, row_number = marks.T
    h, K = (np.array(one).reshape(-1, n) for one in (h_rows, gains))
    return Updates(step_, code_, component, row_number, h, K)


def find_record_rows(t: FloatArray, code: int, data: SensorData) -> IntArray:
    """Return the rows of a sensor record from which the measurements used at t (M,) come."""
    record = data.baro if code == BARO else data.fixes
    if record is None:
        return np.zeros(len(t), np.int64)
    return np.clip(np.searchsorted(record.t_arrival, t - SAME_INSTANT), 0, len(record.t) - 1)


def _join_nodes(stretches: list[Nodes]) -> Nodes:
    """Return segments of a run, in their order, as one."""
    if len(stretches) == 1:
        return stretches[0]
    firsts = np.cumsum([0, *(len(one.t) for one in stretches)])
    output = [
        np.where(one.output >= 0, one.output + first, -1)
        for one, first in zip(stretches, firsts[:-1], strict=True)
    ]
    t, state, P, Phi = (
        np.concatenate([getattr(one, name) for one in stretches]) for name in ("t", "state", "P", "Phi")
    )
    return Nodes(stretches[0].layout, t, state, P, Phi, np.concatenate(output))
