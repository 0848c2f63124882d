"""A flight that stops at each sample of the IMU, so that its controls can follow that sample.

JSBSim makes four steps in a sample. Exact increments need the states of three steps after it: controls that
answer a sample act from the fourth, and on the motion from the next sample on.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from bench.core.mathematics.arrays import FloatArray
from bench.core.records.data import Events, Trajectory
from bench.core.records.flight_specs import FlightSpec
from bench.core.words.exceptions import FlightError
from bench.simulation.flight.cockpit import SURFACES, Cockpit
from bench.simulation.flight.exceedances import Exceedances
from bench.simulation.flight.guidance.sequencer import FlownLeg, describe, fly_legs
from bench.simulation.flight.guidance.shaping import GUIDANCE_RATE, Steps, wait
from bench.simulation.flight.guidance.steering import Commanded, Commands, SurfaceCommand
from bench.simulation.flight.recorder import prepare
from bench.simulation.flight.state_log import NEIGHBORS, StateLog
from bench.simulation.flight.truth import Stretch, make_truth
from bench.simulation.flight.turbulence.dryden import through_turbulence
from bench.simulation.flight.turbulence.wind import Weather
from bench.simulation.sampled.sample_motion import SampleMotion, SampleWindow

STEPS = NEIGHBORS + 1
"""Of JSBSim in a sample."""


class _Waiting(Commanded):
    """A leg without commands of its own: those of each sample act at once."""

    def fly(self, cockpit: Cockpit) -> Steps:
        """Let the duration pass."""
        return wait(self.duration)


@dataclass(frozen=True, slots=True)
class _SampledStretch(Stretch):
    """A segment with air data at each sample."""

    rate: float = 0.0

    @property
    def t_air(self) -> FloatArray:
        row = round(self.first * self.motion.dt * self.rate) + self.before
        t: FloatArray = (row + np.arange(len(self.air))) / self.rate
        return t


class _SampleLog(StateLog):
    """Log of the states, with air data at each sample in place of each 50 ms."""

    def __init__(self, fdm: Any, dt: float, spec: FlightSpec) -> None:
        super().__init__(fdm, dt, f"aircraft {spec.aircraft.name}", spec.aircraft.imu_b, guided=True)
        self.per_tick = STEPS

    def read_state(self, *, stored: bool) -> list[float]:
        """Return the state of this step."""
        state = [read() for read in self._read_state]
        if stored:
            self._extend(state)
        return state

    def read_air(self) -> FloatArray:
        """Store air data and controls of the last stored state, and return them: `Stretch.air`, (14,)."""
        self.keep_air()
        row: FloatArray = np.array(self._slow[-len(self._units) :]) * self._units
        return row[:14]


class SampleFlight:
    """A flight of a plan without its legs; guidance holds it until the first command.

    Parameters
    ----------
    spec : FlightSpec
        The plan; its rate is that of the samples [Hz].
    duration : float
        Of the flight [s].
    commands : Commands
        Its present surface command acts after each sample.

    Raises
    ------
    FlightError
        If the aircraft cannot be loaded or trimmed.
    """

    def __init__(self, spec: FlightSpec, duration: float, commands: Commands) -> None:
        self._commands, self._rate, self._leg = commands, spec.rate, _Waiting(duration, commands)
        dt = 1.0 / (STEPS * spec.rate)
        spec = replace(spec, legs=(self._leg,), duration=duration)
        fdm, cockpit = prepare(spec, dt)
        assert isinstance(cockpit, Cockpit)
        self._cockpit = cockpit
        self._move = [self._cockpit.switch(f"fcs/{name}-cmd-norm") for name in SURFACES]
        self._run: Callable[[], Any] = through_turbulence(fdm, spec, dt)
        self._log, self._window = _SampleLog(fdm, dt, spec), SampleWindow(STEPS, dt, spec.aircraft.imu_b)
        for _ in range(NEIGHBORS):
            self._window.push(self._log.read_state(stored=False))
            self._run()
        self._exceedances = Exceedances(spec, fdm, spec.rate)
        self._flown: list[FlownLeg] = []
        self._ticks = fly_legs(self._cockpit, spec, self._flown, Weather(fdm, spec))
        self._per_tick, self._step, self._held = round(1.0 / (GUIDANCE_RATE * dt)), 0, True
        self._count, self._row, self._given = round(duration * spec.rate), 0, 0
        self._stretch: list[Stretch] = []
        self._truth = make_truth(iter(self._stretch.pop, None), spec.rate)
        self._pieces: list[Trajectory] = []
        self.ended = ""
        """Why the aircraft has not flown to the end."""

    def fly(self) -> Iterator[tuple[SampleMotion, FloatArray]]:
        """Yield the motion over each sample, and the air at its end (`Stretch.air`); first those at t = 0.

        It ends at the duration, or where the aircraft fails.
        """
        self._window.push(self._log.read_state(stored=True))
        air = self._log.read_air()
        for row in range(self._count + 1):
            try:
                if row:
                    self._steer()
                    self._advance()
                    air = self._log.read_air()
                for _ in range(NEIGHBORS):
                    self._advance()
            except FlightError as error:
                self.ended = str(error)
                return
            self._row = row
            yield self._window.compute(row / self._rate), air

    @property
    def uncut(self) -> int:
        """Samples since the last cut."""
        return self._row - self._given

    def cut(self) -> Trajectory:
        """Return the truth since the last cut: at least one sample."""
        (stretch,) = self._log.cut(self.uncut / GUIDANCE_RATE, kept=0)
        self._exceedances.add(stretch)
        parts = (stretch.first, stretch.motion, stretch.air, stretch.ground)
        self._stretch.append(_SampledStretch(*parts, rate=self._rate))
        self._given = self._row
        self._pieces.append(next(self._truth))
        return self._pieces[-1]

    def finish(self, ended: str) -> list[Trajectory]:
        """Return the truth in pieces; ``ended`` says why it is not flown to the end, or is empty.

        Raises
        ------
        FlightError
            If nothing has been flown.
        """
        if self.uncut:
            self.cut()
        if not self._pieces:
            raise FlightError(ended or "nothing has been flown")
        t = self._row / self._rate
        rows = [(0.0, t, "leg", describe(1, self._leg)), *([(t, t, "crash", ended)] if ended else [])]
        *pieces, last = self._pieces
        return [*pieces, replace(last, events=Events.from_rows([*rows, *self._exceedances.rows()]))]

    def _steer(self) -> None:
        """Let the present command act, without the lags that guidance has for commands at 20 Hz."""
        wanted = self._commands.wanted
        if not isinstance(wanted, SurfaceCommand):
            return
        if self._held:
            self._cockpit.lat_mode(0)
            self._cockpit.lon_mode(0)
            self._cockpit.thr_mode(0)
            self._held = False
        for move, value in zip(self._move, (wanted.aileron, wanted.elevator, wanted.rudder), strict=True):
            move(value)
        self._cockpit.set_throttle(wanted.throttle)

    def _advance(self) -> None:
        if self._step % self._per_tick == 0:
            next(self._ticks, None)
        self._step += 1
        self._run()
        self._window.push(self._log.read_state(stored=True))
