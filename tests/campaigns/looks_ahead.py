"""Filters that use the future in one place each, or get at what they are not given, and odd honest ones.

Each runs in a process of its own that imports this file: nothing here takes long to import.
"""

from __future__ import annotations

import gc
import hashlib
import os
import sys
import tempfile
import time
from dataclasses import fields, replace
from pathlib import Path

import numpy as np

from bench.core.mathematics import rotation
from bench.core.records.data import Events, InitialState, NavSolution, SensorData, Trajectory
from bench.navigation.built_in import load

_ANSWERS = ("lla", "vel_n", "q_nb", "cov", "gyro_bias_b", "accel_bias_b", "extra", "extra_sd")


class Ahead:
    """`loose-15`, and `smoother` in some rows or columns."""

    columns: tuple[str, ...] = _ANSWERS

    def run(self, sensors: SensorData, initial: InitialState) -> NavSolution:
        honest = load("loose-15", {}).run(sensors, initial)
        return self.mix(honest, load("smoother", {}).run(sensors, initial), self.rows(sensors, honest))

    def rows(self, sensors: SensorData, honest: NavSolution) -> np.ndarray:
        """Return where it looks ahead."""
        return np.ones(len(honest.t), bool)

    def mix(self, honest: NavSolution, ahead: NavSolution, rows: np.ndarray) -> NavSolution:
        taken = {}
        for name in self.columns:
            own, other = getattr(honest, name), getattr(ahead, name)
            other = other[:, : own.shape[1]]  # the smoother has more states
            taken[name] = np.where(rows.reshape(-1, *[1] * (own.ndim - 1)), other, own)
        return replace(honest, **taken)


def since_fix(sensors: SensorData, t: np.ndarray) -> np.ndarray:
    """Return the time since the last fix arrived [s]; infinite before the first."""
    arrived = np.sort(sensors.fixes.t_arrival)
    last = np.searchsorted(arrived, t, "right") - 1
    return np.where(last < 0, np.inf, t - arrived[np.maximum(last, 0)])


# --- the future, in one place ------------------------------------------------------------------------------


class AheadInOutages(Ahead):
    """Only where fixes are missing."""

    def rows(self, sensors, honest):
        return np.isfinite(since := since_fix(sensors, honest.t)) & (since > 1.5)


class AheadAfterOutages(Ahead):
    """Only in the 3 s after fixes were missing."""

    def rows(self, sensors, honest):
        arrived = np.sort(sensors.fixes.t_arrival)
        back = arrived[1:][np.diff(arrived) > 1.5]
        return ((honest.t[:, None] >= back) & (honest.t[:, None] < back + 3.0)).any(axis=1)


class AheadAtTheStart(Ahead):
    """Only in the first tenth of the record."""

    def rows(self, sensors, honest):
        return honest.t < honest.t[0] + 0.1 * (honest.t[-1] - honest.t[0])


class AheadInFaults(Ahead):
    """Only where a fix is far from the last one."""

    def rows(self, sensors, honest):
        lla = sensors.fixes.lla
        jumps = np.abs(np.diff(lla[:, 2])) + 6.4e6 * np.linalg.norm(np.diff(lla[:, :2], axis=0), axis=1)
        at = sensors.fixes.t_arrival[1:][jumps > 200.0]
        return ((honest.t[:, None] >= at) & (honest.t[:, None] < at + 3.0)).any(axis=1)


class AheadInCovariance(Ahead):
    """Only what it reports of its accuracy."""

    columns = ("cov",)


class AheadInBiases(Ahead):
    """Only the biases and the further states."""

    columns = ("gyro_bias_b", "accel_bias_b", "extra", "extra_sd")


class AheadInEvents(Ahead):
    """Only its alarms: 1 s before the height of a fix jumps."""

    def mix(self, honest, ahead, rows):
        return honest

    def run(self, sensors, initial):
        honest = load("loose-15", {}).run(sensors, initial)
        climbs = np.diff(sensors.fixes.lla[:, 2])
        at = sensors.fixes.t_arrival[1:][np.abs(climbs) > 2.0] - 1.0
        more = [(float(t), float(t) + 0.1, "integrity", "soon", "gnss") for t in at]
        return replace(honest, events=Events.from_rows([*honest.events.rows(), *more]))


class AheadInOneRunOfEight(Ahead):
    """Only where a hash of the first sample says so; half of the runs with ``share = 2``."""

    def __init__(self, *, share: int = 8) -> None:
        self.share = share

    def rows(self, sensors, honest):
        first = hashlib.sha256(sensors.imu.dvel_b[:1].tobytes()).digest()[0]
        return np.full(len(honest.t), first % self.share == 0)


class LeaksALittle(Ahead):
    """A billionth of the answer comes from the smoother."""

    def mix(self, honest, ahead, rows):
        return replace(honest, vel_n=honest.vel_n + 1e-9 * (ahead.vel_n - honest.vel_n))


class KnowsWhenFixesReturn(Ahead):
    """Claims less in an outage the sooner the next fix comes."""

    def mix(self, honest, ahead, rows):
        return honest

    def run(self, sensors, initial):
        honest = load("loose-15", {}).run(sensors, initial)
        arrived = np.append(np.sort(sensors.fixes.t_arrival), np.inf)
        until = arrived[np.searchsorted(arrived, honest.t, "right")] - honest.t
        gain = 1.0 / (1.0 + np.minimum(until, 10.0))
        return replace(honest, cov=honest.cov * gain[:, None, None])


class KnowsItsWay(Ahead):
    """Claims more where it will be north of its start in 5 s: no noise changes that."""

    def mix(self, honest, ahead, rows):
        soon = np.minimum(np.searchsorted(honest.t, honest.t + 5.0), len(honest.t) - 1)
        gain = np.where(honest.lla[soon, 0] > honest.lla[0, 0], 1.1, 1.0)
        return replace(honest, cov=honest.cov * gain[:, None, None])


class KnowsTheNextTurn(Ahead):
    """Corrects its heading by the turn of the next second, rounded to 5 deg."""

    def mix(self, honest, ahead, rows):
        q_nb = honest.q_nb.copy()
        soon = np.minimum(np.searchsorted(honest.t, honest.t + 1.0), len(honest.t) - 1)
        turn = rotation.to_rotvec(rotation.multiply(rotation.conjugate(q_nb), q_nb[soon]))[:, 2]
        by = np.zeros((len(q_nb), 3))
        by[:, 2] = 0.01 * np.deg2rad(5.0) * np.round(turn / np.deg2rad(5.0))
        return replace(honest, q_nb=rotation.multiply(q_nb, rotation.from_rotvec(by)))


class AheadByOneStep(Ahead):
    """Each answer is the mean of two: its own and that of the next epoch."""

    def mix(self, honest, ahead, rows):
        return replace(honest, vel_n=(honest.vel_n + np.roll(honest.vel_n, -1, axis=0)) / 2)


class StreamsHonestly:
    """Smooths a whole record, and is honest when it is fed in pieces."""

    def run(self, sensors: SensorData, initial: InitialState) -> NavSolution:
        return load("smoother", {}).run(sensors, initial)

    def in_pieces(self, first, initial, events):
        return load("loose-15", {}).in_pieces(first, initial, events)


class SmoothsInPieces(StreamsHonestly):
    """Smooths a whole record, and makes no answer final until the last piece."""

    def in_pieces(self, first, initial, events):
        return load("smoother", {}).in_pieces(first, initial, events)


# --- who is asking ----------------------------------------------------------------------------------------


class SeesTheAudit(Ahead):
    """Smooths unless the callers are of the audit."""

    def rows(self, sensors, honest):
        frame, names = sys._getframe(), []
        while frame:
            names.append(frame.f_code.co_filename)
            frame = frame.f_back
        return np.full(len(honest.t), not any("causality" in name for name in names))


_CALLS: list[int] = []
_KNOWN: set[bytes] = set()


class SmoothsItsFirstRuns(Ahead):
    """Smooths the first three records of its process."""

    def rows(self, sensors, honest):
        _CALLS.append(len(sensors.imu.t))
        return np.full(len(honest.t), len(_CALLS) <= 3)


class NoticesARepeat(Ahead):
    """Smooths a record unless it has seen its start before: the module keeps it."""

    def rows(self, sensors, honest):
        first = sensors.imu.dvel_b[:20].tobytes()
        known, _ = first in _KNOWN, _KNOWN.add(first)
        return np.full(len(honest.t), not known)


# --- what is not given to it ------------------------------------------------------------------------------


class Asks(Ahead):
    """`loose-15`, after it has had a look at something."""

    def run(self, sensors, initial):
        self.look()
        return load("loose-15", {}).run(sensors, initial)

    def look(self) -> None:
        raise NotImplementedError


class ReadsItsParent(Asks):
    """Reads the memory map of the process that asks."""

    def look(self):
        Path(f"/proc/{os.getppid()}/maps").read_text()


class ReadsItself(Asks):
    """Reads its own memory map."""

    def look(self):
        Path("/proc/self/maps").read_text()


class ReadsAFolder(Asks):
    """Reads the names in a folder: the truths, the results or the cards."""

    def __init__(self, *, folder: str = ".") -> None:
        self.folder = folder

    def look(self):
        for name in os.listdir(self.folder):
            print(name, file=sys.stderr)


class ReadsAFile(ReadsAFolder):
    """Reads one file."""

    def look(self):
        Path(self.folder).read_bytes()


class KeepsFiles(Ahead):
    """Leaves what it has seen in a file of the folder of temporary files, for its next run."""

    def run(self, sensors, initial):
        place = Path(tempfile.gettempdir()) / "seen-by-a-filter.npy"
        found = load("loose-15", {}).run(sensors, initial)
        before = np.load(place) if place.exists() else found.vel_n
        np.save(place, found.vel_n)
        return replace(found, vel_n=(found.vel_n + before) / 2)


class AsksTheCollector(Ahead):
    """Looks for a truth, or the answers of others, among the objects of its process."""

    def run(self, sensors, initial):
        found = load("loose-15", {}).run(sensors, initial)
        for one in gc.get_objects():
            if isinstance(one, Trajectory):
                lla = [np.interp(found.t, one.t, one.lla[:, k]) for k in range(3)]
                return replace(found, lla=np.column_stack(lla))
        return found


# --- not repeatable ---------------------------------------------------------------------------------------


class UsesTheClock(Ahead):
    """Its answer depends on the time of day."""

    def run(self, sensors, initial):
        found = load("loose-15", {}).run(sensors, initial)
        return replace(found, vel_n=found.vel_n + 1e-12 * (time.time_ns() % 1_000_003))


class ThrowsADie(Ahead):
    """Another answer each time."""

    def run(self, sensors, initial):
        found = load("loose-15", {}).run(sensors, initial)
        return replace(found, vel_n=found.vel_n + 1e-9 * (1 + os.urandom(1)[0]))


class ClaimsByADie(Ahead):
    """Another bias each time, and nothing else."""

    def run(self, sensors, initial):
        found = load("loose-15", {}).run(sensors, initial)
        return replace(found, gyro_bias_b=found.gyro_bias_b + 1e-12 * (1 + os.urandom(1)[0]))


# --- honest, and odd --------------------------------------------------------------------------------------


class OncePerSecond(Ahead):
    """Answers at whole seconds, and holds each answer until the next."""

    def run(self, sensors, initial):
        found = load("loose-15", {}).run(sensors, initial)
        rows = np.searchsorted(found.t, np.floor(found.t + 1e-9) - 1e-9)
        held = {name: getattr(found, name)[rows] for name in _ANSWERS}
        return replace(found, **held)


class Single(Ahead):
    """Answers in single precision."""

    def run(self, sensors, initial):
        found = load("loose-15", {}).run(sensors, initial)
        return replace(found, **{name: getattr(found, name).astype(np.float32) for name in _ANSWERS})


class WithoutBiases(Ahead):
    """Estimates no biases, and no further states."""

    def run(self, sensors, initial):
        found = load("loose-15", {}).run(sensors, initial)
        none, no_states = np.full_like(found.gyro_bias_b, np.nan), np.empty((len(found.t), 0))
        return replace(
            found, gyro_bias_b=none, accel_bias_b=none, extra_names=(), extra=no_states, extra_sd=no_states
        )


class Backdates(Ahead):
    """Tells of an alarm when it ends: the row begins 2 s before it is told."""

    def run(self, sensors, initial):
        found = load("loose-15", {}).run(sensors, initial)
        climbs = np.diff(sensors.fixes.lla[:, 2])
        at = sensors.fixes.t_arrival[1:][np.abs(climbs) > 2.0]
        more = [(float(t) - 2.0, float(t), "odd", "height jumped", "gnss") for t in at]
        return replace(found, events=Events.from_rows([*found.events.rows(), *more]))


def _blank(sensors: SensorData) -> NavSolution:
    n = len(sensors.output_t)
    none, no_states = np.full((n, 3), np.nan), np.empty((n, 0))
    cov = np.full((n, 9, 9), np.nan)
    q_nb = np.full((n, 4), np.nan)
    return NavSolution(sensors.output_t, none, none, q_nb, none, none, cov, (), no_states, no_states)


class AttitudeOnly(Ahead):
    """Adds up the gyros, and knows nothing else."""

    def run(self, sensors, initial):
        found, imu = _blank(sensors), sensors.imu
        q_nb = np.empty((len(imu.t) + 1, 4))
        q_nb[0] = initial.q_nb
        for k, turn in enumerate(rotation.from_rotvec(imu.dtheta_b)):
            q_nb[k + 1] = rotation.multiply(q_nb[k], turn)
        cov = found.cov.copy()
        cov[:, 6:, 6:] = np.diag(np.full(3, 0.05**2))
        return replace(found, q_nb=q_nb[np.searchsorted(imu.t, found.t + 1e-6, "right")], cov=cov)


class Particles(Ahead):
    """Height alone, by 50 particles of one seed that are drawn for the whole record at once."""

    def run(self, sensors, initial):
        found, fixes = _blank(sensors), sensors.fixes
        rng = np.random.default_rng(20260101)
        steps = rng.normal(scale=2.0, size=(len(fixes.t), 50)).cumsum(axis=0)
        lla = np.tile(initial.lla, (len(found.t), 1))
        for row, arrived in enumerate(fixes.t_arrival):
            weight = np.exp(-0.5 * ((initial.lla[2] + steps[row] - fixes.lla[row, 2]) / 5.0) ** 2)
            mean = initial.lla[2] + np.average(steps[row], weights=weight + 1e-12)
            lla[found.t >= arrived] = np.append(fixes.lla[row, :2], mean)
        cov = found.cov.copy()
        cov[:, :3, :3] = np.diag(np.full(3, 5.0**2))
        return replace(found, lla=lla, cov=cov)


class FailsAtAJump(Ahead):
    """Raises an error where the velocity of the fixes jumps, and counts how often."""

    failed = 0

    def run(self, sensors, initial):
        if np.abs(np.diff(sensors.fixes.vel_n, axis=0)).max() > 15.0:
            type(self).failed += 1
            raise RuntimeError("the fixes have jumped")
        return load("loose-15", {}).run(sensors, initial)


ODD = ("OncePerSecond", "Single", "WithoutBiases", "Backdates", "AttitudeOnly", "Particles")
"""Honest filters."""

assert set(_ANSWERS) <= {one.name for one in fields(NavSolution)}
