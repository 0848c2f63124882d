"""Server of ArduPilot's SITL with its JSON interface over UDP, in lock-step.

A packet of servo outputs comes in, the truth and the measurements of the IMU go out as JSON. By SIM_JSON.cpp,
SIM_JSON.h and examples/JSON/readme.md in libraries/SITL of ArduPilot: the reply goes to where the packet came
from; a packet without a reply comes again after a second, with the same count; a count that begins anew is a
SITL that has restarted; a time that goes back tells SITL that the flight has.
"""

from __future__ import annotations

import math
import select
import socket
import struct
import time
from collections.abc import Callable
from dataclasses import astuple
from typing import NamedTuple, NoReturn

import numpy as np

from bench.core.mathematics.arrays import FloatArray
from bench.core.mathematics.earth import difference_kernel
from bench.core.words.exceptions import EstimatorStoppedError
from bench.pipeline.autopilot_flight import RestartedError, Sample
from bench.plugins.hil.actuator_channels import ActuatorChannels
from bench.plugins.hil.client_session import FlightPace
from bench.simulation.flight.guidance.steering import Commands, SurfaceCommand

PORT = 9002
"""Where SITL looks for its physics."""

CHANNELS = 32
_MAGIC = {18458: struct.Struct("<HHI16H"), 29569: struct.Struct("<HHI32H")}
_VECTOR = "[%.9g,%.9g,%.9g]"
_LINE = (
    f'\n{{"timestamp":%.6f,"imu":{{"gyro":{_VECTOR},"accel_body":{_VECTOR}}},"position":{_VECTOR},'
    f'"quaternion":[%.9g,%.9g,%.9g,%.9g],"velocity":{_VECTOR},"airspeed":%.9g}}\n'
)
_BLOCK = 2048
_BY_NOW = 0.5  # a packet that comes again within this was sent before the reply [s]
_LATE = 10  # packets: what is older by no more has been overtaken
_LEAST, _CENTER, _MOST = 1000.0, 1500.0, 2000.0  # of the pulses [us]
_FAR = 500.0  # beyond these they are no servo pulses [us]
_POWER = 0.05  # throttle that no autopilot gives disarmed


class ServoPacket(NamedTuple):
    """Outputs of SITL."""

    frame: int  # its number
    pulses: tuple[int, ...]  # (16,) or (32,) [us]; 0: none

    @classmethod
    def parse(cls, data: bytes) -> ServoPacket | None:
        """Return the packet in a datagram; None if it is something else."""
        layout = _MAGIC.get(int.from_bytes(data[:2], "little"))
        if layout is None or len(data) != layout.size:
            return None
        _, _, frame, *pulses = layout.unpack(data)
        return cls(frame, tuple(pulses))


class JsonSession:
    """The server of one SITL.

    Parameters
    ----------
    server : socket
        A bound UDP socket.
    commands : Commands
        What SITL wants of the controls is put there.
    rate : float
        Seconds of the flight per second at most; 0: as fast as possible.
    patience : float
        Longest silence of SITL [s].
    channels : ActuatorChannels
        Which output moves what.
    start : (3,) array
        Where the flight begins [rad, rad, m]: positions are relative to it.
    """

    aided = False

    def __init__(
        self,
        server: socket.socket,
        commands: Commands,
        rate: float,
        patience: float,
        *,
        channels: ActuatorChannels,
        start: FloatArray,
    ) -> None:
        server.setblocking(False)
        self._server, self.commands, self._patience = server, commands, patience
        self._rate = rate if 0 < rate < math.inf else 0.0
        self._channels, self._start, self.pace = channels, start, FlightPace()
        self._peer: tuple[str, int] | None = None
        self._count, self._said, self._told_at = -1, b"", -math.inf
        self._strange = 0  # datagrams that were no packets
        self._imu = np.zeros(6)  # the last that was finite
        self._powered, self._most = False, max(map(abs, astuple(channels)))
        self.ended = ""
        """Why the session was ended, in words."""

    def wait(self, say: Callable[[str], object]) -> None:
        """Wait for the first packet, without a limit of time."""
        self._take(self._receive(math.inf))
        assert self._peer is not None
        say(f"a client has come from {self._peer[0]}")

    def close(self, words: str, *, good: bool) -> None:
        """Forget SITL: its interface has no last message."""
        self._peer = None

    def exchange(self, sample: Sample) -> None:
        """Send a sample, and take the outputs that answer it.

        Raises
        ------
        EstimatorStoppedError
            If SITL is silent, or sends pulses that are none of servos.
        RestartedError
            If SITL has restarted.
        """
        if self._rate:
            self.pace.keep(sample.motion.t, self._rate)
        self._said = self._write(sample)
        self._send()
        self._take(self._receive(time.monotonic() + self._patience))

    def _write(self, sample: Sample) -> bytes:
        """Return a line of JSON between line feeds: the last whole one is what SITL reads."""
        true, place = sample.motion, np.empty(3)
        difference_kernel(true.lla, self._start, place)
        measured = np.concatenate(sample.rates)
        if np.isfinite(measured).all():  # a sensor that fails repeats its last value
            self._imu = measured
        values = np.concatenate([self._imu, place, true.q_nb, true.vel_n]).tolist()
        return (_LINE % (true.t, *values, sample.air[3])).encode()

    def _send(self) -> None:
        assert self._peer is not None
        try:
            self._server.sendto(self._said, self._peer)
        except OSError as error:
            self._refuse(f"cannot be reached: {error.strerror or error}")
        self._told_at = time.monotonic()

    def _receive(self, until: float) -> ServoPacket:
        """Return the next packet that is not one again; a time of infinity has no limit."""
        while True:
            left = until - time.monotonic()
            ready = left > 0 and select.select([self._server], [], [], None if math.isinf(left) else left)[0]
            if not ready:
                also = f"; {self._strange} datagrams were no servo packets" if self._strange else ""
                self._refuse(f"has been silent for {self._patience:g} s{also}")
            try:
                data, address = self._server.recvfrom(_BLOCK)
            except OSError:  # a datagram that was damaged, or the error of a reply that found nobody
                continue
            packet = ServoPacket.parse(data)
            if packet is None:
                self._strange += 1
            elif self._peer is None:
                self._peer, self._count = address, packet.frame
                return packet
            elif packet.frame < self._count - _LATE or (packet.frame == 0 < self._count):
                self._peer, self._count, before = address, packet.frame, self._count
                self._take(packet, anew=True)
                raise RestartedError(f"the client has restarted after its frame {before}")
            elif address == self._peer and packet.frame > self._count:
                self._count = packet.frame
                return packet
            elif address == self._peer and packet.frame == self._count and self._is_overdue():
                self._send()

    def _is_overdue(self) -> bool:
        """Return whether a packet that comes again was sent after the reply, which has been lost."""
        return bool(self._said) and time.monotonic() - self._told_at > _BY_NOW

    def _take(self, packet: ServoPacket, *, anew: bool = False) -> None:
        """Put the outputs of a packet into effect, from the first with power on."""
        if anew:
            self._powered, self._said, self.commands.wanted = False, b"", None
            self.pace.forget()
        if (most := self._most) > len(packet.pulses):
            outputs = f"sends {len(packet.pulses)} outputs, --channels has {most}"
            self._refuse(f"{outputs}; SERVO_32_ENABLE of ArduPilot makes them 32")
        one = self._channels
        aileron, elevator, rudder = (self._read(packet, k) for k in (one.aileron, one.elevator, one.rudder))
        power = packet.pulses[abs(one.throttle) - 1] and 0.5 * (1.0 + self._read(packet, one.throttle))
        self._powered = self._powered or power > _POWER
        if self._powered:
            self.commands.wanted = SurfaceCommand(aileron, elevator, rudder, power)

    def _read(self, packet: ServoPacket, channel: int) -> float:
        """Return an output, -1 to 1; one without a pulse is in the middle."""
        if not (pulse := packet.pulses[abs(channel) - 1]):
            return 0.0
        if not _LEAST - _FAR <= pulse <= _MOST + _FAR:
            self._refuse(
                f"sent {pulse} us in output {abs(channel)}; a servo takes {_LEAST:g} to {_MOST:g} us"
            )
        share = (pulse - _CENTER) / (_MOST - _CENTER)
        return math.copysign(1.0, channel) * min(max(share, -1.0), 1.0)

    def _refuse(self, what: str) -> NoReturn:
        self.ended = self.commands.ended = text = f"the client {what}"
        raise EstimatorStoppedError(text)
