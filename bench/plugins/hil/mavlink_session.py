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
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np

from bench.core.mathematics import earth, rotation
from bench.core.mathematics.arrays import FloatArray
from bench.core.mathematics.units import SAME_INSTANT, STANDARD_GRAVITY
from bench.core.records.data import GnssFixes
from bench.core.words.exceptions import ConfigError, EstimatorStoppedError
from bench.pipeline.autopilot_flight import Sample
from bench.plugins.hil.actuator_channels import ActuatorChannels
from bench.plugins.hil.client_session import ClientSession
from bench.simulation.flight.guidance.steering import Commands
from bench.simulation.signals.air import impact_pressure, standard_atmosphere

PORT = 4560
"""Where PX4 looks for its simulator."""

# SensorSource of SimulatorMavlink.hpp; acceleration and rates are in every message
_IMU, _UPDATES = 0b111111, {"mag": 0b111000000, "baro": 0b1101000000000, "airspeed": 0b10000000000}
_ARMED = 128  # MAV_MODE_FLAG_SAFETY_ARMED
_GAUSS = 1e-4  # [T]
_FASTEST = 327.67  # [m/s], of an int16 in cm/s
_LARGEST = 655.34  # [m], of an uint16 in cm
_BOOT_RATE = 1.0  # real time, until the autopilot commands
_LATE = 1.0  # for the answer to a HIL_SENSOR [s]
_TRUTH_RATE = 20.0  # of HIL_STATE_QUATERNION [Hz]
_QUIET = 0.2  # without controls before lock-step begins [s]
_WORDS = 50  # of a STATUSTEXT [bytes]


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
    undulation : float
        Height of the geoid above the ellipsoid [m]: what MAVLink's heights are lower.

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
        undulation: float = 0.0,
    ) -> None:
        super().__init__(server, commands, rate, patience)
        try:
            self._dialect: Any = importlib.import_module("pymavlink.dialects.v20.common")
        except ImportError:
            raise ConfigError("--mavlink needs pymavlink: pip install pymavlink") from None
        self._channels, self._truth = channels, truth
        self._mav = self._dialect.MAVLink(None)
        self._undulation = undulation
        self._readings = _Readings(alt)
        self._answers = self._armed = False
        self._due = math.inf  # when it must have commanded [s]
        self._second = self._shown = 0  # of the flight, those of the last HEARTBEAT and truth
        self.unanswered = 0
        """Number of HIL_SENSOR in lock-step that stayed without an answer."""

    def begin(self) -> None:
        """Wait for a HEARTBEAT, and answer with one."""
        self._mav = self._dialect.MAVLink(None)
        self._wait_for(lambda message: message.get_type() == "HEARTBEAT", "sent no HEARTBEAT")
        self.send(self._pack(self._make_heartbeat()))

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

    aided = True

    def wait(self, say: Callable[[str], object]) -> None:
        """Wait for an autopilot that begins."""
        self._say = say
        super().wait(say)

    def exchange(self, sample: Sample) -> None:
        """Send a sample and what has arrived, and read the controls of the reply.

        An autopilot that has not commanded is given real time to start; after that the flight waits for an
        answer to each HIL_SENSOR. One that stays without an answer for a second is counted, and the next is
        sent: an autopilot that needs two samples for an answer would else wait as well.

        Raises
        ------
        EstimatorStoppedError
            If the autopilot sends what is no message, closes the connection, or is silent.
        """
        try:
            self._exchange(sample)
        except EstimatorStoppedError:
            if self._answers or not self.closed:
                raise
            self._say(f"{self.ended}; waiting {self.patience:g} s for another")
            self.ended, self._due = "", math.inf
            self.commands.ended = ""
            self._server.settimeout(self.patience)
            try:
                self.wait(self._say)
            except TimeoutError:
                self.refuse(f"has not come back for {self.patience:g} s")
            finally:
                self._server.settimeout(None)

    def _exchange(self, sample: Sample) -> None:
        t, waits, now = sample.motion.t, self._answers, time.monotonic()
        if math.isinf(self._due):
            self._due = now + self.patience
        block = [self._pack(message) for message in self._make_messages(sample)]
        if math.floor(t) > self._second:
            self._second = math.floor(t)
            block.insert(0, self._pack(self._make_heartbeat()))
        self.send(b"".join(block))
        if self.rate or not waits:
            self.pace.keep(t, self.rate or _BOOT_RATE)
        if waits and sample.imu.valid[0]:
            self._wait_for_answer(now + _LATE)
            return
        for message in self.receive_ready():
            self._take(message)
        if self._answers and not waits:
            self._wait_for_quiet()
        elif not waits and time.monotonic() > self._due:
            self.refuse(f"has sent no HIL_ACTUATOR_CONTROLS for {self.patience:g} s")

    # --- what is sent

    def _pack(self, message: Any) -> bytes:
        packed: bytes = message.pack(self._mav)
        self._mav.seq = (self._mav.seq + 1) % 256
        return packed

    def _make_heartbeat(self) -> Any:
        dialect = self._dialect
        kind, autopilot = dialect.MAV_TYPE_GENERIC, dialect.MAV_AUTOPILOT_INVALID
        return dialect.MAVLink_heartbeat_message(kind, autopilot, 0, 0, 0, 3)

    def _make_messages(self, sample: Sample) -> Iterator[Any]:
        """Yield what has arrived, the truth 20 times a second, and a HIL_SENSOR for a sample within range."""
        readings, t = self._readings, sample.motion.t
        for name, record, row in sample.come:
            if name == "fixes":
                yield self._make_fix(record, row)
            elif name in _UPDATES:
                self._take_reading(name, record, row)
                readings.updated |= _UPDATES[name]
        if self._truth and math.floor(_TRUTH_RATE * (t + SAME_INSTANT)) > self._shown:
            self._shown = math.floor(_TRUTH_RATE * (t + SAME_INSTANT))
            yield self._make_state(sample)
        if sample.imu.valid[0]:
            rate, force = sample.rates
            air = readings.pressure, readings.impact, readings.alt, readings.temperature
            values = *force.tolist(), *rate.tolist(), *readings.mag, *air
            updated, readings.updated = _IMU | readings.updated, 0
            yield self._dialect.MAVLink_hil_sensor_message(round(1e6 * t), *values, updated)

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

    def _make_fix(self, fixes: GnssFixes, k: int) -> Any:
        """Return the HIL_GPS of a fix; a fix without velocity counts as no fix, as HIL_GPS requires one."""
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
        values = *self._to_place(lla), eph, epv, *velocity, round(100.0 * course) % 36000
        count = int(fixes.satellites[k])
        used = min(count, 254) if count >= 0 else 255  # 255: not known
        return self._dialect.MAVLink_hil_gps_message(round(1e6 * fixes.t[k]), 3 if good else 0, *values, used)

    def _make_state(self, sample: Sample) -> Any:
        """Return HIL_STATE_QUATERNION: the truth at the end of a sample."""
        true, dt = sample.motion, float(sample.imu.dt[0])
        gravity = earth.gravity_n(true.lla[0], true.lla[2])
        motion = true.dvel_b / dt + rotation.matrix(true.q_nb).T @ gravity  # Coriolis, < 0.01 m/s^2, left out
        rate = true.dtheta_b / dt  # the Earth's, 7e-5 rad/s, is in it
        milli_g = np.clip(1e3 * motion / STANDARD_GRAVITY, -32767, 32767).round().astype(int)
        return self._dialect.MAVLink_hil_state_quaternion_message(
            round(1e6 * true.t), true.q_nb.tolist(), *rate.tolist(), *self._to_place(true.lla),
            *map(self._to_cm, true.vel_n.tolist()), self._to_cm(sample.air[3]), self._to_cm(sample.air[2]),
            *milli_g.tolist(),
        )  # fmt: skip

    def _to_place(self, lla: FloatArray) -> tuple[int, int, int]:
        """Return latitude, longitude [1e-7 deg] and height above mean sea level [mm]."""
        lat, lon = np.degrees(lla[:2]).tolist()
        alt = float(lla[2]) - self._undulation
        return round(1e7 * lat), round(1e7 * ((lon + 180.0) % 360.0 - 180.0)), round(1e3 * alt)

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

    def _wait_for_answer(self, late: float) -> None:
        """Wait for the controls that answer a HIL_SENSOR, until a time [s] or the end of the patience."""
        while (message := self.receive_until(min(late, self._due))) is not None:
            if self._take(message):
                return
            if time.monotonic() > self._due:
                break
        if time.monotonic() >= self._due:
            self.refuse(f"has not answered a HIL_SENSOR for {self.patience:g} s")
        self.unanswered += 1

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
        self.pace.forget()

    def _take(self, message: Any) -> bool:
        """Process a message; return whether it contained controls."""
        if message.get_type() != "HIL_ACTUATOR_CONTROLS":
            return False
        self._answers, self._due = True, time.monotonic() + self.patience
        self._armed = self._armed or bool(message.mode & _ARMED)
        if self._armed:
            command = self._channels.take(message.controls)
            surfaces = (command.aileron, command.elevator, command.rudder)
            if not (0 <= command.throttle <= 1 and all(abs(value) <= 1 for value in surfaces)):
                wrong = command.describe_wrong()
                self.refuse(f"sent HIL_ACTUATOR_CONTROLS with {wrong} in a channel of --channels")
            self.commands.wanted = command
        return True
