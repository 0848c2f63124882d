"""Set-points that the legs write to the guidance system of an aircraft with wings, in SI."""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import partial
from typing import Any

from bench.core.records.flight_specs import FlightSpec
from bench.core.words.exceptions import FlightError
from bench.simulation.flight.ground.gear import find_wheels
from bench.simulation.flight.guidance.belief import Belief
from bench.simulation.flight.guidance.shaping import GUIDANCE_RATE, smoothstep
from bench.simulation.flight.panel import Panel
from bench.simulation.flight.turbulence.dryden import LIGHT
from bench.simulation.flight.turbulence.thermals import locate_thermals

SURFACES = ("aileron", "elevator", "rudder")

# fastest change of an airspeed set-point [m/s^2], below what full power gives each aircraft
_SPEED_CHANGE = 0.5


class Cockpit(Panel):
    """The controls and instruments of one flight on wings."""

    def __init__(self, fdm: Any, spec: FlightSpec, belief: Belief | None = None) -> None:
        super().__init__(fdm, spec, belief)
        reader, switch = self.reader, self.switch
        self.find_wheels = partial(find_wheels, spec.aircraft, fdm)

        def writer(name: str) -> Callable[[float], None]:
            return switch(f"guidance/{name}")

        def gain(name: str) -> float:
            if not (value := reader(f"guidance/{name}")()) > 0:
                place = f"aircraft {spec.aircraft.name}: gain {name}"
                raise FlightError(f"{place} must be above 0; it is {value:g}")
            return value

        self.gain = gain
        self.load_factor = reader("accelerations/Nz")  # one step late, which control does not mind
        self.bank_wanted, self.pitch_wanted = (reader(f"guidance/{k}-wanted-rad") for k in ("bank", "pitch"))
        self.lat_mode, self.lon_mode, self.thr_mode = (writer(f"{k}-mode") for k in ("lat", "lon", "thr"))
        self.set_bank, self.set_heading = writer("bank-setpoint-rad"), writer("heading-setpoint-rad")
        self.set_pitch, self.set_pitch_trim = writer("pitch-setpoint-rad"), writer("pitch-trim-rad")
        self.set_climb, self.set_alt = writer("climb-setpoint-mps"), writer("altitude-setpoint-m")
        self.set_speed, self.set_throttle = writer("airspeed-setpoint-mps"), writer("throttle-cmd-norm")
        self.throttle = reader("guidance/throttle-cmd-norm")
        self.set_bank_limit = writer("bank-limit-rad")
        self.set_steering = writer("steer-share")
        self.direct = {name: writer(f"{name}-direct-norm") for name in SURFACES}
        self.direct_share = {name: writer(f"{name}-direct-share") for name in SURFACES}
        self.surface = {name: reader(f"fcs/{name}-cmd-norm") for name in SURFACES}
        self._brakes = [switch(f"fcs/{side}-brake-cmd-norm") for side in ("left", "right")]
        self._throttle_trim, self._speed_gain = writer("throttle-trim-norm"), reader("guidance/speed-gain")
        begun = {name: reader(f"guidance/{name}")() for name in spec.aircraft.gains}
        self.approach_gains = spec.aircraft.approach_gains
        self._landed = [(writer(name), begun[name], to) for name, to in self.approach_gains.items()]
        begun |= self.approach_gains
        self.smooth_air = spec.severity == 0 and not spec.gusts
        flared = spec.aircraft.flare_gains if spec.severity >= LIGHT else {}
        self._flared = [(writer(name), begun[name], to) for name, to in flared.items()]
        self.thermal_places = locate_thermals(spec)  # latitude and longitude, the nearest to the start first
        self.course = self.heading()  # the heading to hold between turns, not wrapped [rad]
        self._read_lags()
        self._plan: tuple[float, float, int, int] | None = None  # an airspeed change on its way
        self.speed_wanted = 0.0  # the airspeed set-point [m/s]
        self.alt_wanted = self.alt()  # the altitude set-point [m]

    def hold_heading(self) -> None:
        """Hold the heading of this time from here on."""
        self.course = self.heading()
        self.set_heading(self.course)
        self.lat_mode(2)

    def hold_alt(self, alt: float) -> None:
        """Hold an ellipsoidal height [m]; a glider holds its airspeed by pitch and sinks."""
        self.alt_wanted = alt
        self.set_alt(alt)
        self.lon_mode(4 if self.aircraft.glides else 3)

    def _read_lags(self) -> None:
        """Measure the lag of the control loops behind a moving set-point [s]."""
        self.bank_lag = 2 / self.gain("bank-lag-rad_sec")
        self.pitch_lag = 1 / self.gain("pitch-lag-rad_sec")
        if not self.aircraft.glides:
            self.climb_lag = self.pitch_lag + 1 / self.gain("climb-gain")

    def hold_approach(self, share: float) -> None:
        """Interpolate the gains from the gains of flight, 0, to the gains of an approach, 1."""
        for write, begun, end in self._landed:
            write(begun + share * (end - begun))
        self._read_lags()

    def hold_firmly(self, share: float) -> None:
        """Interpolate the gains from the gains of flight, 0, to the gains of a flare in rough air, 1."""
        for write, begun, end in self._flared:
            write(begun + share * (end - begun))

    def brake(self, share: float) -> None:
        """Set the wheel brakes, 0 to 1."""
        for write in self._brakes:
            write(share)

    def start_speed(self, speed: float) -> None:
        """Begin to hold an airspeed [m/s] without a jump of the throttle."""
        self.speed_wanted, self._plan = speed, None
        self.set_speed(speed)
        self._throttle_trim(self.throttle() - self._speed_gain() * (speed - self.speed()))
        self.thr_mode(1)

    def change_speed(self, speed: float) -> None:
        """Begin to move the airspeed set-point to another value [m/s]; :meth:`tick` continues the change."""
        change = abs(speed - self.speed_wanted)
        if change > 0:
            n = max(1, math.ceil(1.5 * change / _SPEED_CHANGE * GUIDANCE_RATE))
            self._plan = (self.speed_wanted, speed, 0, n)

    def tick(self) -> None:
        """Continue the changes in progress; call once per epoch."""
        if self._plan is not None:
            begun, end, k, n = self._plan
            self.speed_wanted = begun + smoothstep((k + 1) / n) * (end - begun)
            self.set_speed(self.speed_wanted)
            self._plan = (begun, end, k + 1, n) if k + 1 < n else None

    def fastest(self) -> float:
        """Highest commanded airspeed of the rest of the flight [m/s]."""
        return self.speed_wanted if self._plan is None else max(self.speed_wanted, self._plan[1])

    def change_time(self) -> float:
        """Time until the airspeed set-point stays [s]."""
        return 0.0 if self._plan is None else (self._plan[3] - self._plan[2]) / GUIDANCE_RATE

    def speed_settled(self) -> bool:
        """Return whether no airspeed change is in progress."""
        return self._plan is None
