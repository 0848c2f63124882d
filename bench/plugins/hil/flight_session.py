"""Server of a client with the messages of `hil.flight_messages`; the flight waits for the client."""

from __future__ import annotations

import math
import socket
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from bench.core.records.data import InitialState, NavSolution, SensorData
from bench.io.streams.frames import make_frame, make_frames
from bench.navigation.engine.record_cuts import nothing_known
from bench.plugins.hil import flight_messages as messages
from bench.plugins.hil.client_session import ClientSession
from bench.plugins.hil.flight_messages import FlightFrame, FrameReader, pack
from bench.simulation.flight.guidance.steering import AttitudeCommand, Commands, SurfaceCommand

_UNIT = 1e-3  # a quaternion has the length 1 within
_LONGEST_WORDS = 240  # of END, a byte each; a payload has at most 255
_FASTEST, _LARGEST_BIAS, _LARGEST_SD = 1e4, 100.0, 1e7  # [m/s], [rad/s] or [m/s^2], [m]


@dataclass(frozen=True, slots=True)
class FlightFacts:
    """Data that a client gets before the flight."""

    rate: float  # of the IMU [Hz]
    period: float  # between turns [s]
    duration: float  # of the flight, NaN if not known [s]


class FlightSession(ClientSession):
    """The server of one client; parameters as of `ClientSession`.

    Parameters
    ----------
    facts : FlightFacts
        Of the flight.
    steers : bool
        Whether the client may give commands.
    """

    def __init__(
        self,
        server: socket.socket,
        facts: FlightFacts,
        commands: Commands,
        rate: float,
        patience: float,
        *,
        steers: bool,
    ) -> None:
        super().__init__(server, commands, rate, patience)
        self._facts, self._steers = facts, steers
        self._told = False
        self._out, self._number = bytearray(), 0
        self.estimates = 0
        """How many the client gave."""

    def recount(self) -> list[NavSolution]:
        """Return an empty list: a client does not report innovations and events."""
        return []

    def begin(self) -> None:
        """Process the HELLO of the client."""
        self._reader = FrameReader()
        frame = self.receive()
        if frame.kind != messages.HELLO:
            self.refuse(f"began with {frame.name}; HELLO comes first")
        (version,) = self._check(frame)
        if version != messages.VERSION:
            self.refuse(f"speaks version {version:g} of the messages; this is version {messages.VERSION}")

    def read(self, data: bytes) -> list[FlightFrame]:
        """Return the frames in the bytes."""
        return list(self._reader.take(data))

    @property
    def inside(self) -> bool:
        """Return whether a frame has arrived only in part."""
        return self._reader.inside

    def make_end(self, words: str, *, good: bool, known: bool = True) -> bytes:
        """Return the message END."""
        body = words.encode()[:_LONGEST_WORDS] + bytes([good])
        return make_frame(messages.END, self._number if known else 0, body)

    def answer(self, data: SensorData, initial: InitialState, end: float) -> NavSolution:
        """Send the data that arrived by a time [s], wait for the reply, and return its estimate.

        Without an estimate a row of NaN.

        Raises
        ------
        EstimatorStoppedError
            If the client sends what is no answer, closes the connection, or is silent.
        """
        if not self._told:
            self._tell_start(data, initial)
            self._told = True
        for kind, body in make_frames(data):
            self._queue(kind, body)
        self._queue(messages.TURN, pack(end))
        self.send(bytes(self._out))
        self._out.clear()
        found = nothing_known(np.array([end]))
        seen = set[int]()
        while (frame := self.receive()).kind != messages.DONE:
            kind = messages.SURFACES if frame.kind == messages.ATTITUDE else frame.kind
            if kind in seen:
                self.refuse(f"sent two answers of one kind ({frame.name}) at {end:g} s")
            seen.add(kind)
            t, *values = self._check(frame)
            self._check_time(frame, t, end)
            if kind == messages.SURFACES and not self._steers:
                self.refuse(f"sent {frame.name}; bench serve --give commands lets a client steer")
            if frame.kind == messages.ESTIMATE:
                found = self._read_estimate(frame, values, found)
            elif frame.kind == messages.ATTITUDE:
                self.commands.wanted = self._read_command(frame, AttitudeCommand(*values))
            elif frame.kind == messages.SURFACES:
                self.commands.wanted = self._read_command(frame, SurfaceCommand(*values))
            else:
                self.refuse(f"sent {frame.name} as an answer; that is for the begin")
        self._check_time(frame, self._check(frame)[0], end)
        if self.rate:
            self.pace.keep(end, self.rate)
        return found

    # --- what is sent

    def _tell_start(self, data: SensorData, initial: InitialState) -> None:
        facts = self._facts
        ground = math.nan if data.ground_alt is None else data.ground_alt
        date = math.nan if data.date is None else data.date
        told = (messages.VERSION, facts.rate, facts.period, facts.duration, *data.antenna_b, ground, date)
        self._queue(messages.HELLO, pack(*told))
        with np.errstate(invalid="ignore"):
            sd = np.sqrt(np.diag(initial.cov))
        state = (initial.t, *initial.lla, *initial.vel_n, *initial.q_nb, *sd)
        self._queue(messages.START, pack(*state, valid=initial.alignment == "given"))

    def _queue(self, kind: int, body: bytes) -> None:
        self._out += make_frame(kind, self._number, body)
        self._number += 1

    # --- what comes

    def _check(self, frame: FlightFrame) -> tuple[float, ...]:
        """Return the numbers of a message of a client; its length must be right."""
        count = messages.COUNTS.get(frame.kind)
        if count is None:
            self.refuse(f"sent {frame.name}, which is none of {', '.join(_SENT)}")
        if len(frame.payload) != 8 * count + 1:
            right = 8 * count + 1
            self.refuse(f"sent {frame.name} with {len(frame.payload)} bytes; {right} are right")
        return frame.values()

    def _check_time(self, frame: FlightFrame, t: float, end: float) -> None:
        if t != end:
            self.refuse(f"sent {frame.name} for {t:g} s at the turn of {end:g} s")

    def _read_estimate(self, frame: FlightFrame, values: list[float], empty: NavSolution) -> NavSolution:
        if not frame.valid:
            return empty
        row = np.array(values)[None]
        lla, vel_n, q_nb = row[:, 0:3], row[:, 3:6], row[:, 6:10]
        if not np.isfinite(row[:, :10]).all():
            self.refuse("sent an ESTIMATE with NaN in position, velocity or attitude")
        if not (abs(lla[0, 0]) <= math.pi / 2 and abs(lla[0, 1]) <= math.tau and abs(lla[0, 2]) < 1e6):
            self.refuse("sent an ESTIMATE that is no latitude, longitude [rad] and height [m]")
        if not abs(float(np.linalg.norm(q_nb)) - 1.0) < _UNIT:
            self.refuse("sent an ESTIMATE whose quaternion has not the length 1")
        sd = row[:, 16:25]
        if not (np.abs(vel_n) < _FASTEST).all() or (np.abs(row[:, 10:16]) > _LARGEST_BIAS).any():
            self.refuse("sent an ESTIMATE with a velocity or bias beyond any aircraft")
        if (sd <= 0).any() or (sd > _LARGEST_SD).any():
            self.refuse(
                f"sent an ESTIMATE with a standard deviation that is not in 0 to {_LARGEST_SD:g}; NaN: none"
            )
        cov = np.where(np.eye(9, dtype=bool), (sd**2)[:, None], 0.0)
        known: dict[str, Any] = {"lla": lla, "vel_n": vel_n, "q_nb": q_nb / np.linalg.norm(q_nb)}
        if np.isfinite(sd).all():
            known["cov"] = cov
        self.estimates += 1
        return replace(empty, gyro_bias_b=row[:, 10:13], accel_bias_b=row[:, 13:16], **known)

    def _read_command(
        self, frame: FlightFrame, wanted: AttitudeCommand | SurfaceCommand
    ) -> AttitudeCommand | SurfaceCommand:
        if wrong := wanted.describe_wrong():
            self.refuse(f"sent {frame.name} with {wrong}")
        return wanted


_SENT = ("HELLO", "ESTIMATE", "ATTITUDE", "SURFACES", "DONE")
