"""The covariance of the compiled filters moves as their own state does: F, every row of H, and the reset.

Nothing is taken from the equations of the filter. A state with a small error goes through the steps of a
filter that rejects every measurement; what differs in state and innovations from the state without the error
is held against the transition that a smoother is given, and against the variance of the innovations, from
which H follows by polarization: with P = (r + e)(r + e)', S - R = ((H r) + (H e))^2. All states have values,
those of temperature of their full size: errors larger than what is measured beside them.
"""

from __future__ import annotations

from dataclasses import fields, replace

import numpy as np
import pytest

from bench.core.mathematics import rotation
from bench.core.records.instruments import (
    INSTRUMENTS,
    AirspeedData,
    AirspeedSpec,
    HeadingSpec,
    MagSpec,
    OdometerSpec,
    RadarSpec,
)
from bench.core.records.sensor_specs import ImuSpec, ThermalSpec, TriadSpec
from bench.navigation.built_in import load
from bench.navigation.error_state_filter.error_state import feedback_kernel, less_errors, state_errors
from bench.navigation.models.loose_tight import Passage
from bench.navigation.start.steady_course import Gyros
from bench.simulation import sensors
from tests.builders import put, take
from tests.navigation.test_tight import UNITS as WITH_SKY
from tests.weaving import DEG, units, weaving

ARM = (5.0, -4.0, 4.8)  # 8 m
IMU = ImuSpec(
    "every-error",
    TriadSpec(
        random_walk=0.3 * DEG / 60, bias_instability=10 * DEG / 3600, bias_correlation=100.0,
        bias_model="flicker", turn_on_bias_sd=1.0 * DEG, scale_factor_sd=0.01, misalignment_sd=0.02,
        temperature_sd=0.5 * DEG, nonlinearity_sd=1e-3, scale_asymmetry_sd=2e-3, range=8.7,
        g_sensitivity_sd=0.02 * DEG, g2_sensitivity_sd=1e-3 * DEG,
    ),
    TriadSpec(
        random_walk=0.1 / 60, bias_instability=5e-4, bias_correlation=100.0, bias_model="flicker",
        turn_on_bias_sd=0.3, scale_factor_sd=0.01, misalignment_sd=0.02, temperature_sd=0.01,
        nonlinearity_sd=1e-3, quadratic_sd=1e-4, range=80.0,
    ),
    thermal=ThermalSpec(self_heating=10.0, time_constant=300.0),
)  # fmt: skip
ATTITUDES = [(0.0, 0.0, 0.6), (0.5, -0.3, 2.5), (-0.9, 0.4, -1.9)]
RATE = 50.0


def record(attitude, standing, sky=False):
    """One second of samples, and of each instrument the reading at its end."""
    spec = replace(WITH_SKY, imu=IMU, antenna_b=ARM) if sky else replace(units(IMU), antenna_b=ARM)
    more = {
        "airspeed": AirspeedSpec("speed", 10.0, 0.5),
        "mag": MagSpec(
            "mag",
            10.0,
            white_sd=2e-7,
            hard_iron_sd=5e-7,
            soft_iron_sd=0.02,
            scale_factor_sd=0.01,
            misalignment_sd=0.03,
        ),
        "radar": RadarSpec("radar", 10.0, white_sd=0.3, range=2000.0, bias_sd=0.5),
        "odometer": OdometerSpec("wheel", 10.0, white_sd=0.05, scale_factor_sd=0.02),
        "heading": HeadingSpec("two", 10.0, white_sd=0.003, wander_sd=0.002, bias_sd=0.01, max_slope=1.4),
    }
    spec = replace(spec, **more, assumed=replace(spec.assumed, imu=IMU, **more), ground_alt=700.0)
    truth = weaving(2.0, rate=RATE)  # without air
    sensed = sensors.sense(truth, replace(spec, airspeed=None), 3, 0)
    one = np.array([1.0])
    data = replace(sensed.data, airspeed=AirspeedData(one, one, one > 0, 33.0 * one, 0.5 * one))
    n = int(RATE)
    imu = take(data.imu, np.arange(n))
    initial = replace(sensed.initial, q_nb=rotation.from_euler(*attitude))
    if standing:
        turn = np.tile([0.01, -0.008, 0.012], (n, 1))
        force = np.tile(rotation.rotate(rotation.conjugate(initial.q_nb), [0.1, -0.05, -9.81]), (n, 1))
        initial = replace(initial, vel_n=np.zeros(3))
    else:  # a motion in which every state acts
        phase = np.linspace(0.0, 1.0, n)[:, None]
        turn = np.array([0.5, -0.4, 0.7]) + 0.1 * np.sin(3 * phase + [0.0, 1.0, 2.0])
        force = np.array([3.0, 2.0, -11.0]) + np.cos(3 * phase + [0.0, 1.0, 2.0])
        initial = replace(initial, vel_n=np.array([30.0, 18.0, -2.0]))
    imu = replace(imu, dtheta_b=turn / RATE, dvel_b=force / RATE)
    names = {f.name for f in fields(data)} & {"fixes", *INSTRUMENTS}
    last = {}
    for name in names:
        one = getattr(data, name)
        row = [int(np.searchsorted(one.t, 1.0 - 1e-6))] if one is not None else []
        last[name] = None if one is None else replace(take(one, row), t_arrival=one.t[row])
    if sky:
        last["observations"] = data.observations
    return replace(data, imu=imu, output_t=np.array([1.0]), **last), initial


def sizes(model):
    """Standard deviation of each state: how large its value is, and in which unit its error counts."""
    sd = np.sqrt(np.maximum(np.diag(model.P), model.process.stationary))
    return np.where(sd > 0, sd, 1.0)


class Probe:
    """A filter that rejects all measurements, from any state and covariance."""

    def __init__(self, name, options, attitude, *, standing=False, sky=False):
        self.data, self.initial = record(attitude, standing, sky)
        self.filter = load(name, {"covariance_hz": None, **options})
        passage = self.passage()
        self.model = passage.run.model
        self.size = sizes(self.model)
        self.size[:9] = np.repeat([10.0, 1.0, 1e-3], 3)
        clock = self.model.index.clock_offset
        if clock >= 0:
            self.size[clock : clock + 3] = 0.1
        rng = np.random.default_rng(8)
        self.state = passage.run.now.state.copy()
        own = passage.run.now.state[10:] == 0.0  # what begins at zero gets a value
        self.names = [f"{block}[{k}]" for block, _, size in self.model.layout.blocks for k in range(size)]
        share = np.array([1.0 if "temperature" in name else 0.1 for name in self.names[9:]])
        self.state[10:][own] = (share * self.size[9:] * rng.choice([-1.0, 1.0], len(own)))[own]

    def passage(self):
        return Passage(self.filter, self.data, self.initial, [], keep=True, gyros=Gyros(steady=True))

    def go(self, error, P):
        """Errors of the state before the last measurements, their innovations and variances, Phi."""
        passage = self.passage()
        run = passage.run
        run.now.state[:] = self.state
        feedback_kernel(run.now.state, -error)  # takes an error out: here it puts one in
        n = len(error)
        run.now.P[:, :n] = P
        run.gate = run.gate._replace(nis=np.full(4, -1.0), readmit_after_s=np.inf)
        solution, (nodes,) = passage.update(self.data, 0.0, last=True), passage.stretches
        table = solution.innovations
        late = table.t > 1.0 - 1e-6
        assert late.any()
        assert not table.accepted.any()
        marks = zip(table.code[late], table.component[late], strict=True)
        rows = [f"{table.sensor[code]}[{component}]" for code, component in marks]
        Phi = np.eye(n)
        for one in nodes.Phi:
            Phi = one @ Phi
        return nodes.state[-1, 0], table.z[late], table.S[late], rows, Phi

    def correct(self, P, which, size):
        """States and P before and after one reading of a barometer that corrects a state by a size."""
        specs = replace(self.data.specs, baro=replace(self.data.specs.baro, white_sd=1e6))
        data, n = replace(self.data, specs=specs, fixes=take(self.data.fixes, [])), len(P)
        if data.observations is not None:
            lost = np.full_like(data.observations.pseudorange, np.nan)
            data = replace(data, observations=put(data.observations, slice(None), pseudorange=lost))

        def used(off):
            read = put(data.baro, 0, alt_baro=data.baro.alt_baro[0] + off)
            more = Gyros(steady=True)
            passage = Passage(self.filter, replace(data, baro=read), self.initial, [], keep=True, gyros=more)
            run = passage.run
            run.now.state[:], run.now.P[:, :n] = self.state, P
            run.gate = run.gate._replace(nis=np.full(4, np.inf))
            solution = passage.update(replace(data, baro=read), 0.0, last=True)
            (nodes,) = passage.stretches
            assert (solution.innovations.code == solution.innovations.sensor.index("baro")).all()
            before, after = nodes.state[-1]
            return before, after, nodes.P[-1, 0], nodes.P[-1, 1]

        first = state_errors(*used(1e6)[:2])[which] - state_errors(*used(0.0)[:2])[which]
        return used(1e6 * size / first)

    def compare(self):
        """Derivatives of state and innovations by each error at the start: from differences, and reported."""
        n, none = len(self.size), np.zeros(len(self.size))
        state, z, R, rows, Phi = self.go(none, np.zeros((n, n)))
        moved, seen, claimed = np.zeros((n, n)), np.zeros((len(rows), n)), np.zeros((len(rows), n))
        step = 1e-3
        weights = np.random.default_rng(5).uniform(1.0, 2.0, n)
        reference = self.size * weights * np.where(np.arange(n) < 15, 1e3, 30.0)
        _, z_r, _, _, _ = self.go(1e-6 * reference, np.zeros((n, n)))
        H_r = np.sign(z - z_r) * np.sqrt(self.go(none, np.outer(reference, reference))[2] - R)
        for k in range(n):
            e = np.zeros(n)
            e[k] = self.size[k]
            up, z_up, _, _, _ = self.go(step * e, np.zeros((n, n)))
            moved[:, k] = state_errors(up, state) / step
            seen[:, k] = (z - z_up) / step
            S = self.go(none, np.outer(reference + e, reference + e))[2]
            claimed[:, k] = np.sign(H_r) * np.sqrt(S - R) - H_r
        return rows, (moved / self.size[:, None], Phi * self.size / self.size[:, None]), (seen, claimed)


def assert_alike(found, claimed, rows, names):
    """Each element within 10 % of itself and 2 % of the largest of its row: products of small errors."""
    bad = np.abs(found - claimed) > 0.1 * np.abs(found) + 0.02 * np.abs(found).max(axis=1, keepdims=True)
    assert not bad.any(), [
        f"{rows[i]} by {names[k]}: {found[i, k]:.4g}, in P {claimed[i, k]:.4g}"
        for i, k in np.argwhere(bad)[:12]
    ]


AIR = {"airspeed": True, "magnetometer": True, "radar": True, "coordinated": True, "heading": True}
WHEELS = {"odometer": True, "nonholonomic": True, "standstill": True, "axle_b": [-3.0, 1.0, 2.0]}
CASES = {
    "air": ("loose-full", {"lever_arm_sd": 0.3, **AIR}, {}),
    "late": ("loose-full", {"lever_arm_sd": 0.3, "time_offset_sd": 2.0}, {}),
    "tight": ("tight", {"every_error": True, "lever_arm_sd": 0.3}, {"sky": True}),
    "wheels": ("loose-full", WHEELS, {}),
    "standing": ("loose-full", WHEELS, {"standing": True}),
}
EVERY = [(case, one) for case in CASES for one in ATTITUDES[: 3 if case in ("air", "late", "tight") else 1]]


@pytest.mark.parametrize(("case", "attitude"), EVERY)
def test_f_and_every_row_of_h_are_the_differences_of_the_filter(case, attitude):
    name, options, more = CASES[case]
    probe = Probe(name, options, attitude, **more)
    rows, (moved, Phi), (seen, claimed) = probe.compare()
    assert "course[0]" in rows
    assert_alike(moved, Phi, probe.names, probe.names)
    assert_alike(seen, claimed, rows, probe.names)


@pytest.mark.parametrize("attitude", ATTITUDES)
@pytest.mark.parametrize("name", ["loose-full", "tight"])
def test_p_after_a_correction_is_that_of_what_is_left_of_the_errors(name, attitude):
    """A measurement so noisy that it tells nothing, and so far off that it turns the heading by 0.3 rad.

    What the feedback leaves of errors about the correction, by differences, is what P must have become.
    """
    sky = name == "tight"
    probe = Probe(name, {"every_error": True} if sky else {}, attitude, sky=sky)
    n, heading = len(probe.size), 8
    probe.size[heading] = 0.1
    probe.size[9:] *= 1e-4  # no bias turns the unit on the way
    root = np.diag(probe.size) @ np.random.default_rng(4).normal(size=(n, n)) / np.sqrt(n)
    P = root @ root.T
    before, after, P_before, P_after = probe.correct(P, heading, 0.3)
    dx = state_errors(before, after)
    assert abs(dx[heading]) == pytest.approx(0.3, rel=0.1)
    step, J = 1e-6 * probe.size, np.zeros((n, n))
    for k in range(n):
        ends = []
        for sign in (1.0, -1.0):
            error = dx.copy()
            error[k] += sign * step[k]
            ends.append(state_errors(after, less_errors(before, error)))
        J[:, k] = (ends[0] - ends[1]) / (2 * step[k])
    scale = np.sqrt(np.diag(P_before))
    found, wanted = (one / scale / scale[:, None] for one in (P_after, J @ P_before @ J.T))
    assert np.abs(found - wanted).max() < 0.02
    assert np.abs(found - P_before / scale / scale[:, None]).max() > 0.05
