"""Server of an autopilot with the MAVLink messages between PX4 and a simulator, in lock-step.

HIL_SENSOR for each sample of the IMU and HIL_GPS for each fix go out, HIL_ACTUATOR_CONTROLS come in. Messages
and units: common.xml of MAVLink, ids 107, 113, 115, 93. Where PX4 reads them otherwise (``fields_updated``,
``eph`` and ``epv`` in cm, the order of begin and lock-step) it goes by PX4:
src/modules/simulation/simulator_mavlink/SimulatorMavlink.cpp and .hpp of PX4-Autopilot.
"""

from __future__ import annotations

import importlib
import math
import socket
import time
from collections import deque
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np

from bench.core.mathematics import earth, rotation
from bench.core.mathematics.arrays import FloatArray
from bench.core.mathematics.units import STANDARD_GRAVITY
from bench.core.records.data import InitialState, NavSolution, SensorData, Trajectory
from bench.core.words.exceptions import ConfigError
from bench.navigation.engine.record_cuts import nothing_known
from bench.navigation.engine.timeline import TIME_TOLERANCE
from bench.plugins.hil.client_session import ClientSession
from bench.simulation.flight.guidance.steering import Commands, SurfaceCommand
from bench.simulation.signals.air import impact_pressure, standard_atmosphere

PORT = 4560
"""Where PX4 looks for its simulator."""

# SensorSource of SimulatorMavlink.hpp; acceleration and rates are in every message
_IMU, _UPDATES = 0b111111, {"mag": 0b111000000, "baro": 0b1101000000000, "airspeed": 0b10000000000}
_STATE = "state"
_ARMED = 128  # MAV_MODE_FLAG_SAFETY_ARMED
_GAUSS = 1e-4  # [T]
_FASTEST = 327.67  # [m/s], of an int16 in cm/s
_LARGEST = 655.34  # [m], of an uint16 in cm
_BOOT_RATE = 1.0  # real time, until the autopilot commands
_QUIET = 0.2  # without controls before lock-step begins [s]
_SHOWN = 20  # of a wrong text, in a message
_WORDS = 50  # of a STATUSTEXT [bytes]


@dataclass(frozen=True, slots=True)
class ActuatorChannels:
    """Assignment of the channels of HIL_ACTUATOR_CONTROLS, from 1; a negative number reverses the sign.

    The defaults are those of PX4's airframe 1033_jsbsim_rascal with the signs of px4-jsbsim-bridge.
    """

    aileron: int = -6
    elevator: int = -8
    rudder: int = -3
    throttle: int = 5

    @classmethod
    def parse(cls, text: str) -> ActuatorChannels:
        """Read a list like ``aileron=-6,throttle=5``.

        Raises
        ------
        ConfigError
            If the text is not such a list.
        """
        found: dict[str, int] = {}
        names = tuple(cls.__slots__)
        for part in filter(None, text.split(",")):
            name, _, number = part.partition("=")
            sign, digits = number[:1], number.removeprefix("-")
            if name not in names:
                raise ConfigError(f"--channels: {name[:_SHOWN]!r} must be one of {', '.join(names)}")
            if name in found:
                raise ConfigError(f"--channels: {name} is given twice")
            short = digits.isascii() and digits.isdecimal() and len(digits) <= 2
            if not (short and 1 <= int(digits) <= 16):
                raise ConfigError(
                    f"--channels: {name}={number[:_SHOWN]!r} must be a channel, 1 to 16 or -1 to -16"
                )
            found[name] = -int(digits) if sign == "-" else int(digits)
        return cls(**found)

    def take(self, controls: list[float]) -> SurfaceCommand:
        """Return the command from the controls of a message."""

        def read(channel: int) -> float:
            return math.copysign(1.0, channel) * controls[abs(channel) - 1]

        return SurfaceCommand(*map(read, (self.aileron, self.elevator, self.rudder, self.throttle)))


@dataclass
class _Readings:
    """Values that a HIL_SENSOR repeats until they are measured again."""

    air: float  # height of the air that the pitot tube feels [m]
    mag: tuple[float, float, float] = (0.0, 0.0, 0.0)  # [gauss]
    pressure: float = 0.0  # [hPa]
    impact: float = 0.0  # [hPa]
    alt: float = 0.0  # [m]
    temperature: float = 0.0  # [degC]
    updated: int = 0  # what the next one tells for the first time


class MavlinkSession(ClientSession):
    """The server of one autopilot; further parameters as of `ClientSession`.

    Parameters
    ----------
    channels : ActuatorChannels
        Which control moves what.
    truth : bool
        Whether HIL_STATE_QUATERNION is sent: it holds the truth.
    alt : float
        Height at the start [m], that of the air until a barometer tells it.

    Raises
    ------
    ConfigError
        If pymavlink is not installed.
    """

    def __init__(
        self,
        server: socket.socket,
        commands: Commands,
        rate: float,
        patience: float,
        *,
        channels: ActuatorChannels,
        truth: bool,
        alt: float,
    ) -> None:
        super().__init__(server, commands, rate, patience)
        try:
            self._dialect: Any = importlib.import_module("pymavlink.dialects.v20.common")
        except ImportError:
            raise ConfigError("--mavlink needs pymavlink: pip install pymavlink") from None
        self._channels, self._truth = channels, truth
        self._mav = self._dialect.MAVLink(None)
        self._flying: Trajectory | None = None
        self._readings = _Readings(alt)
        self._answers = self._armed = False
        self._booted = math.inf  # when it must have commanded [s]
        self._second = 0  # of the flight, that of the last HEARTBEAT

    def begin(self) -> None:
        """Wait for a HEARTBEAT, and answer with one."""
        self._mav = self._dialect.MAVLink(None)
        self._wait_for(lambda message: message.get_type() == "HEARTBEAT", "sent no HEARTBEAT")
        self._send_heartbeat()

    def read(self, data: bytes) -> list[Any]:
        """Return the messages in the bytes."""
        try:
            return self._mav.parse_buffer(data) or []
        except self._dialect.MAVError as error:
            raise ValueError(f"sent an invalid MAVLink message: {error}") from None

    @property
    def inside(self) -> bool:
        """Return whether a message has arrived only in part."""
        return bool(self._mav.buf_len())

    def make_end(self, words: str, *, good: bool, known: bool = True) -> bytes:
        """Return a STATUSTEXT."""
        severity = self._dialect.MAV_SEVERITY_INFO if good else self._dialect.MAV_SEVERITY_ERROR
        text = self._dialect.MAVLink_statustext_message(severity, words.encode()[:_WORDS])
        return self._pack(text)

    def watch(self, piece: Trajectory) -> None:
        """Store the next piece of the truth before its sensors are simulated."""
        self._flying = piece

    def answer(self, data: SensorData, initial: InitialState, end: float) -> NavSolution:
        """Send the data that arrived by a time [s], and read the controls of the reply.

        An autopilot that has not commanded is given real time to start; after that the flight waits for an
        answer to each HIL_SENSOR.

        Raises
        ------
        EstimatorStoppedError
            If the autopilot sends what is no message, closes the connection, or is silent.
        """
        if math.isinf(self._booted):
            self._booted = time.monotonic() + self.patience
        if math.floor(end) > self._second:
            self._second = math.floor(end)
            self._send_heartbeat()
        waits = self._answers
        for message in self._make_messages(data, end):
            self.send(self._pack(message))
            if waits and message.get_type() == "HIL_SENSOR":
                self._wait_for(self._take, "not answered a HIL_SENSOR")
        if self.rate or not waits:
            self.keep_pace(end, self.rate or _BOOT_RATE)
        for message in self.receive_ready():
            self._take(message)
        if self._answers and not waits:
            self._wait_for_quiet()
        elif not waits and time.monotonic() > self._booted:
            self.refuse(f"has sent no HIL_ACTUATOR_CONTROLS for {self.patience:g} s")
        return nothing_known(np.array([end]))

    # --- what is sent

    def _pack(self, message: Any) -> bytes:
        packed: bytes = message.pack(self._mav)
        self._mav.seq = (self._mav.seq + 1) % 256
        return packed

    def _send_heartbeat(self) -> None:
        dialect = self._dialect
        kind, autopilot = dialect.MAV_TYPE_GENERIC, dialect.MAV_AUTOPILOT_INVALID
        self.send(self._pack(dialect.MAVLink_heartbeat_message(kind, autopilot, 0, 0, 0, 3)))

    def _make_messages(self, data: SensorData, end: float) -> Iterator[Any]:
        """Yield a HIL_SENSOR for each used IMU sample, after the other measurements that arrived by its time.

        The truth is that of ``end``.
        """
        imu, readings = data.imu, self._readings
        arrivals = [(end, _STATE, 0)] if self._truth else []
        for name in (*_UPDATES, "fixes"):
            if (record := getattr(data, name)) is not None:
                rows = range(len(record.t)) if name == "fixes" else np.flatnonzero(record.valid).tolist()
                arrivals += [(float(record.t_arrival[row]), name, row) for row in rows]
        due = deque(sorted(arrivals, key=lambda one: one[0]))

        def come(t: float) -> Iterator[Any]:
            while due and due[0][0] <= t + TIME_TOLERANCE:
                _, name, row = due.popleft()
                if name == "fixes":
                    yield self._make_fix(data, row)
                elif name == _STATE:
                    assert self._flying is not None
                    yield self._make_state(self._flying)
                else:
                    self._take_reading(name, getattr(data, name), row)
                    readings.updated |= _UPDATES[name]

        for k in np.flatnonzero(imu.valid):
            yield from come(imu.t[k])
            force, rate = imu.dvel_b[k] / imu.dt[k], imu.dtheta_b[k] / imu.dt[k]
            air = readings.pressure, readings.impact, readings.alt, readings.temperature
            values = *force.tolist(), *rate.tolist(), *readings.mag, *air
            updated, readings.updated = _IMU | readings.updated, 0
            yield self._dialect.MAVLink_hil_sensor_message(round(1e6 * imu.t[k]), *values, updated)
        yield from come(math.inf)

    def _take_reading(self, name: str, record: Any, row: int) -> None:
        now = self._readings
        if name == "mag":
            x, y, z = (record.field_b[row] / _GAUSS).tolist()
            now.mag = x, y, z
        elif name == "baro":
            now.air = now.alt = float(record.alt_baro[row])
            pressure, temperature, _ = standard_atmosphere(now.alt)
            now.pressure, now.temperature = float(pressure) / 100.0, float(temperature) - 273.15
        else:  # what the pitot tube has felt, if the air is that of the standard at this height
            pressure, temperature, _ = standard_atmosphere(now.air)
            now.impact = float(impact_pressure(record.airspeed_true[row], pressure, temperature)) / 100.0

    def _make_fix(self, data: SensorData, k: int) -> Any:
        """Return the HIL_GPS of a fix; a fix without velocity counts as no fix, as HIL_GPS requires one."""
        fixes = data.fixes
        assert fixes is not None
        good = bool(fixes.valid[k]) and bool(np.isfinite([*fixes.lla[k], *fixes.vel_n[k]]).all())
        lla = fixes.lla[k] if good else np.zeros(3)
        north, east, down = fixes.vel_n[k].tolist() if good else (0.0, 0.0, 0.0)
        variance = np.diagonal(fixes.cov_pos_n[k])
        if not (good and (variance >= 0).all()):
            variance = np.full(3, math.inf)
        accuracy = [math.sqrt(variance[0] + variance[1]), math.sqrt(variance[2])]
        eph, epv = (round(100.0 * min(one, _LARGEST)) for one in accuracy)
        speed, course = math.hypot(north, east), math.degrees(math.atan2(east, north)) % 360.0
        velocity = [self._to_cm(one) for one in (speed, north, east, down)]
        values = *_to_place(lla), eph, epv, *velocity, round(100.0 * course) % 36000
        count = int(fixes.satellites[k])
        used = min(count, 254) if count >= 0 else 255  # 255: not known
        return self._dialect.MAVLink_hil_gps_message(round(1e6 * fixes.t[k]), 3 if good else 0, *values, used)

    def _make_state(self, piece: Trajectory) -> Any:
        """Return HIL_STATE_QUATERNION: the truth at the end of a piece."""
        q_nb, dt = piece.q_nb[-1], float(piece.t[-1] - piece.t[-2])
        to_body = rotation.matrix(q_nb).T
        gravity = earth.gravity_n(piece.lla[-1, 0], piece.lla[-1, 2])
        motion = piece.dvel_b[-1] / dt + to_body @ gravity  # Coriolis, below 0.01 m/s^2, is left out
        rate = piece.dtheta_b[-1] / dt  # the Earth's, 7e-5 rad/s, is in it
        milli_g = np.clip(1e3 * motion / STANDARD_GRAVITY, -32767, 32767).round().astype(int)
        air = piece.air
        indicated, true = (
            (float(air.airspeed_calibrated[-1]), float(air.airspeed_true[-1])) if len(air.t) else (0.0, 0.0)
        )
        return self._dialect.MAVLink_hil_state_quaternion_message(
            round(1e6 * piece.t[-1]), q_nb.tolist(), *rate.tolist(), *_to_place(piece.lla[-1]),
            *map(self._to_cm, piece.vel_n[-1].tolist()), self._to_cm(indicated), self._to_cm(true),
            *milli_g.tolist(),
        )  # fmt: skip

    def _to_cm(self, speed: float) -> int:
        if abs(speed) > _FASTEST:
            self.refuse(f"cannot be told of {speed:.0f} m/s: MAVLink holds up to {_FASTEST:.0f} m/s")
        return round(100.0 * speed)

    # --- what comes

    def _wait_for(self, take: Callable[[Any], bool], missed: str) -> None:
        """Pass messages to a function until it returns True; other messages do not extend the time limit."""
        until, silent = time.monotonic() + self.patience, True
        while (message := self.receive_until(until)) is not None:
            silent = False
            if take(message):
                return
        self.refuse(f"has {'been silent' if silent else missed} for {self.patience:g} s")

    def _wait_for_quiet(self) -> None:
        """Read and drop the controls that reply to data sent before lock-step."""
        begun = time.monotonic()
        quiet = begun + _QUIET
        while (message := self.receive_until(quiet)) is not None:
            now = time.monotonic()
            if now > begun + self.patience:
                self.refuse("sends HIL_ACTUATOR_CONTROLS that answer no HIL_SENSOR")
            if self._take(message):
                quiet = now + _QUIET
        self._begun = math.nan  # that is no delay behind the rate

    def _take(self, message: Any) -> bool:
        """Process a message; return whether it contained controls."""
        if message.get_type() != "HIL_ACTUATOR_CONTROLS":
            return False
        self._answers = True
        self._armed = self._armed or bool(message.mode & _ARMED)
        if self._armed:
            command = self._channels.take(message.controls)
            if wrong := command.describe_wrong():
                self.refuse(f"sent HIL_ACTUATOR_CONTROLS with {wrong} in a channel of --channels")
            self.commands.wanted = command
        return True


def _to_place(lla: FloatArray) -> tuple[int, int, int]:
    """Return latitude, longitude [1e-7 deg] and height [mm]."""
    lat, lon = np.degrees(lla[:2]).tolist()
    return round(1e7 * lat), round(1e7 * ((lon + 180.0) % 360.0 - 180.0)), round(1e3 * float(lla[2]))
