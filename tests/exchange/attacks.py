"""Filters that do what a filter should not, each in its own way; what is no harm answers with its start.

It is copied beside the profiles of the tests, where users have theirs.
"""

import ctypes
import gc
import os
import signal
import sys
import threading
import time
from pathlib import Path

import numpy as np

from bench.core.records.data import NavSolution, no_innovations

RUNS = []  # of all instances in this process


def stay(output_t, initial, extra=()):
    """The start, at every time, with further values as states."""
    m = len(output_t)

    def rows(value):
        return np.broadcast_to(value, (m, *np.shape(value))).copy()

    return NavSolution(
        t=output_t,
        lla=rows(initial.lla),
        vel_n=rows(initial.vel_n),
        q_nb=rows(initial.q_nb),
        gyro_bias_b=rows(np.zeros(3)),
        accel_bias_b=rows(np.zeros(3)),
        cov=rows(1e6 * np.eye(9)),
        extra_names=tuple(f"state_{k}" for k in range(len(extra))),
        extra=rows(np.array(extra, float)),
        extra_sd=rows(np.ones(len(extra))),
        innovations=no_innovations(),
    )


class Stays:
    def __init__(self, *, shift=0.0):
        self.runs, self.shift = 0, shift

    def run(self, sensors, initial):
        self.runs += 1
        RUNS.append(self.runs)
        self.act(sensors)
        return stay(sensors.output_t, initial, (os.getpid(), self.runs, len(RUNS), self.shift))

    def act(self, sensors):
        """Do no harm."""


class Prints(Stays):
    def act(self, sensors):
        print("the first line")
        for _ in range(10):
            os.write(1, 20_000_000 * b"x")
        os.write(1, b"\n\xff\n")
        print("the last line", file=sys.stderr)


class Hangs(Stays):
    def act(self, sensors):
        Path("hangs.pid").write_text(str(os.getpid()))
        time.sleep(1000)


class HangsInC(Hangs):
    """Python runs no other thread meanwhile."""

    def act(self, sensors):
        signal.signal(signal.SIGTERM, signal.SIG_IGN)
        Path("hangs.pid").write_text(str(os.getpid()))
        ctypes.PyDLL(None).sleep(1000)


class LeavesThread(Stays):
    def act(self, sensors):
        threading.Thread(target=time.sleep, args=(1000,)).start()


class Exits(Stays):
    def act(self, sensors):
        os._exit(0)


class ExitsLeavingChild(Stays):
    def act(self, sensors):
        if (child := os.fork()) == 0:
            time.sleep(1000)
        Path("child.pid").write_text(str(child))
        os._exit(3)


class Crashes(Stays):
    def act(self, sensors):
        ctypes.string_at(0)


class MovesAway(Stays):
    def act(self, sensors):
        os.chdir("/")


class Patches(Stays):
    def act(self, sensors):
        np.sqrt = np.linalg.norm = np.hypot = None


class Hogs(Stays):
    def act(self, sensors):
        kept = []
        while True:
            kept.append(np.ones(1_000_000))


class AnswersTooMuch(Stays):
    def run(self, sensors, initial):
        return stay(sensors.output_t, initial, np.zeros(20_000))


class Raises(Stays):
    def act(self, sensors):
        raise ArithmeticError("what was not to be")


class Interrupts(Stays):
    def act(self, sensors):
        raise KeyboardInterrupt


class SaysTooMuch(Stays):
    def act(self, sensors):
        raise ValueError(2_000_000 * "no \n")


class TakesRowsAway(Stays):
    """Where the record has checked them already."""

    def run(self, sensors, initial):
        found = super().run(sensors, initial)
        object.__setattr__(found, "cov", found.cov[:3])
        return found


class PutsObjects(Stays):
    def run(self, sensors, initial):
        found = super().run(sensors, initial)
        object.__setattr__(found, "vel_n", np.full(found.vel_n.shape, None))
        return found


class Writes(Stays):
    def act(self, sensors):
        sensors.imu.dvel_b.flags.writeable = True
        sensors.imu.dvel_b[:] *= 1.1


class WritesToMap(Stays):
    """The memory behind an array, whatever its flags say."""

    def act(self, sensors):
        ctypes.memset(sensors.imu.dvel_b.ctypes.data, 0, 8)


class Searches(Stays):
    """Looks for the truth where Python lets one look."""

    def act(self, sensors):
        names = {"Trajectory", "SensorTruth", "Sensed", "Profile", "Fault", "KeplerSets"}
        seen = [f"{one!r:.60}" for one in gc.get_objects() if type(one).__name__ in names]
        frame = sys._getframe()
        while frame is not None:
            seen += [name for name, one in frame.f_locals.items() if type(one).__name__ in names]
            frame = frame.f_back
        for descriptor in Path("/proc/self/fd").iterdir():
            if descriptor.exists() and str(descriptor.resolve()).startswith(("/root", "/home", "/tmp")):
                seen.append(str(descriptor.resolve()))
        if seen:
            raise RuntimeError(f"found {seen[:5]}")


class ExitsWhenCompared(Stays):
    def identity(self, sensors):
        os._exit(4)


class Walks(Stays):
    """Runs in pieces; it counts what it was fed."""

    def run(self, sensors, initial):
        whole = self.in_pieces(sensors, initial, [])
        return whole.update(sensors, 0.0, last=True)

    def in_pieces(self, first, initial, events):
        return _Walk(initial, initial.t, np.zeros(2))


class _Walk:
    def __init__(self, initial, end, count):
        self.initial, self.end, self.count = initial, end, count

    def update(self, piece, look_back, *, last):
        if look_back > 100.0:
            raise ArithmeticError("too far")
        rows = 0 if piece.fixes is None else len(piece.fixes)
        self.count = self.count + np.array([len(piece.imu), rows])
        self.end = float(piece.imu.t.max(initial=self.end))
        return stay(piece.output_t, self.initial, self.count)

    def current(self, head):
        self.count = self.count + 1000  # the caller asks a copy, and drops it
        return stay(np.array([self.end]), self.initial, self.count)

    def copy(self):
        return _Walk(self.initial, self.end, self.count)

    def state(self):
        return {"count": self.count, "end": self.end, "nested": [{"words": "as they are"}]}

    def restore(self, state):
        assert state["nested"] == [{"words": "as they are"}]
        self.count, self.end = np.array(state["count"]), state["end"]


class RefusesMems(Stays):
    """Says before the flight which sensors it cannot be consistent with."""

    def __init__(self, *, least: float = 1.0):
        self.least = least

    def check_sensors(self, specs):
        if self.least < 0.0:
            raise ArithmeticError("no root")
        return f"no {specs.imu.name} for me" if specs.imu.gyro.random_walk < self.least else ""
