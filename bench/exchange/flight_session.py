"""A client on its line while the aircraft flies: it gets sensors as they arrive, and answers at each turn.

In lock-step: the flight waits for each answer. What a client does wrong ends the session with one line.
"""

from __future__ import annotations

import contextlib
import math
import select
import socket
import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any, NoReturn

import numpy as np

from bench.data import InitialState, NavSolution, SensorData
from bench.errors import EstimatorStoppedError
from bench.exchange import flight_messages as messages
from bench.exchange.flight_messages import FlightFrame, FrameReader, pack
from bench.exchange.frames import make_frame, make_frames
from bench.exchange.streaming import wait_until
from bench.flight.steering import AttitudeCommand, Commands, SurfaceCommand
from bench.navigation.engine.record_cuts import nothing_known

_BLOCK = 1 << 16
_UNIT = 1e-3  # a quaternion has the length 1 within
_LONGEST_WORDS = 240  # of END, a byte each; a payload has at most 255
_PATIENCE = 2.0  # for the last words to be sent, and for what the client still sends [s]
_FASTEST, _LARGEST_BIAS, _LARGEST_SD = 1e4, 100.0, 1e7  # [m/s], [rad/s] or [m/s^2], [m]


@dataclass(frozen=True, slots=True)
class FlightFacts:
    """What a client is told before the flight."""

    rate: float  # of the IMU [Hz]
    period: float  # between turns [s]
    duration: float  # of the flight, NaN if not known [s]


class FlightSession:
    """The server of one client.

    Parameters
    ----------
    server : socket
        That waits for connections.
    facts : FlightFacts
        Of the flight.
    commands : Commands
        What the client wants of the controls is put there.
    rate : float
        Seconds of the flight per second at most; 0 or infinity: as fast as possible.
    patience : float
        Longest silence of a client that is to answer [s].
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
        self._server, self._facts, self._commands, self._steers = server, facts, commands, steers
        self._rate, self._patience = rate, patience
        self._line: socket.socket | None = None
        self._reader, self._come = FrameReader(), list[FlightFrame]()
        self._number = 0
        self._begun = 0.0
        self.latest = 0.0
        """Largest delay behind the rate [s]."""
        self.estimates = 0
        """How many the client gave."""
        self.ended = ""
        """Why the session was ended, in words."""

    def wait(self, say: Callable[[str], object]) -> None:
        """Wait for a client and its HELLO.

        Raises
        ------
        EstimatorStoppedError
            If its HELLO is wrong or does not come.
        """
        self._line, address = self._server.accept()
        say(f"a client has come from {address[0]}")
        self._line.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        frame = self._receive()
        if frame.kind != messages.HELLO:
            self._refuse(f"began with {frame.name}; HELLO comes first")
        (version,) = self._check(frame)
        if version != messages.VERSION:
            self._refuse(f"speaks version {version:g} of the messages; this is version {messages.VERSION}")

    def answer(self, data: SensorData, initial: InitialState, end: float) -> NavSolution:
        """Send what has arrived by an instant [s], wait for the answer, and return the estimate in it.

        Without an estimate a row of NaN.

        Raises
        ------
        EstimatorStoppedError
            If the client sends what is no answer, closes the connection, or is silent.
        """
        if not self._begun:
            self._tell_start(data, initial)
            self._begun = time.monotonic() - self._wall(end)
        for kind, body in make_frames(data):
            self._queue(kind, body)
        self._queue(messages.TURN, pack(end))
        self._flush()
        found = nothing_known(np.array([end]))
        seen = set[int]()
        while (frame := self._receive()).kind != messages.DONE:
            kind = messages.SURFACES if frame.kind == messages.ATTITUDE else frame.kind
            if kind in seen:
                self._refuse(f"sent two answers of one kind ({frame.name}) at {end:g} s")
            seen.add(kind)
            t, *values = self._check(frame)
            self._check_time(frame, t, end)
            if kind == messages.SURFACES and not self._steers:
                self._refuse(f"sent {frame.name}; bench serve --give commands lets a client steer")
            if frame.kind == messages.ESTIMATE:
                found = self._read_estimate(frame, values, found)
            elif frame.kind == messages.ATTITUDE:
                self._commands.wanted = self._read_command(frame, AttitudeCommand(*values))
            elif frame.kind == messages.SURFACES:
                self._commands.wanted = self._read_command(frame, SurfaceCommand(*values))
            else:
                self._refuse(f"sent {frame.name} as an answer; that is for the begin")
        self._check_time(frame, self._check(frame)[0], end)
        if 0 < self._rate < math.inf:
            due = self._begun + self._wall(end)
            late = time.monotonic() - due
            self.latest = max(self.latest, late)
            self._begun += max(late, 0.0)  # what was lost is not made up by flying faster
            wait_until(due)
        return found

    def close(self, words: str, *, good: bool) -> None:
        """Send the last words and close the connection."""
        if self._line is None:
            return
        body = words.encode()[:_LONGEST_WORDS] + bytes([good])
        with contextlib.suppress(OSError):
            self._line.settimeout(_PATIENCE)
            self._queue(messages.END, body)
            self._flush()
            self._line.shutdown(socket.SHUT_WR)
            until = time.monotonic() + _PATIENCE
            # what it has sent and nobody read would take END from it
            while time.monotonic() < until and self._line.recv(_BLOCK):
                pass
        self._line.close()
        self._line = None

    # --- what is sent

    def _wall(self, t: float) -> float:
        return t / self._rate if 0 < self._rate < math.inf else 0.0

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

    _out = b""

    def _flush(self) -> None:
        data, self._out = self._out, b""
        assert self._line is not None
        try:
            self._line.settimeout(self._patience)
            self._line.sendall(data)
        except TimeoutError:
            self._refuse(f"has taken nothing for {self._patience:g} s")
        except OSError:
            self._refuse("has closed the connection")

    # --- what comes

    def _receive(self) -> FlightFrame:
        """Return the next frame; meanwhile send away who else comes."""
        assert self._line is not None
        until = time.monotonic() + self._patience
        while not self._come:
            left = until - time.monotonic()
            ready = select.select([self._line, self._server], [], [], max(0.0, left))[0]
            if self._server in ready:
                self._send_away()
            if self._line in ready:
                self._read()
            elif left <= 0:
                self._refuse(f"has been silent for {self._patience:g} s")
        return self._come.pop()

    def _read(self) -> None:
        assert self._line is not None
        try:
            data = self._line.recv(_BLOCK)
        except OSError:
            data = b""
        if not data:
            where = " in the middle of a message" if self._reader.inside else ""
            self._refuse(f"has closed the connection{where}")
        try:
            self._come = list(self._reader.take(data))[::-1]
        except ValueError as error:
            self._refuse(str(error))

    def _send_away(self) -> None:
        other, _ = self._server.accept()
        with other, contextlib.suppress(OSError):
            other.sendall(make_frame(messages.END, 0, b"another client flies; one at a time\x00"))

    def _check(self, frame: FlightFrame) -> tuple[float, ...]:
        """Return the numbers of a message of a client; its length must be right."""
        count = messages.COUNTS.get(frame.kind)
        if count is None:
            self._refuse(f"sent {frame.name}, which is none of {', '.join(_SENT)}")
        if len(frame.payload) != 8 * count + 1:
            right = 8 * count + 1
            self._refuse(f"sent {frame.name} with {len(frame.payload)} bytes; {right} are right")
        return frame.values()

    def _check_time(self, frame: FlightFrame, t: float, end: float) -> None:
        if t != end:
            self._refuse(f"sent {frame.name} for {t:g} s at the turn of {end:g} s")

    def _read_estimate(self, frame: FlightFrame, values: list[float], empty: NavSolution) -> NavSolution:
        if not frame.valid:
            return empty
        row = np.array(values)[None]
        lla, vel_n, q_nb = row[:, 0:3], row[:, 3:6], row[:, 6:10]
        if not np.isfinite(row[:, :10]).all():
            self._refuse("sent an ESTIMATE with NaN in position, velocity or attitude")
        if not (abs(lla[0, 0]) <= math.pi / 2 and abs(lla[0, 1]) <= math.tau and abs(lla[0, 2]) < 1e6):
            self._refuse("sent an ESTIMATE that is no latitude, longitude [rad] and height [m]")
        if not abs(float(np.linalg.norm(q_nb)) - 1.0) < _UNIT:
            self._refuse("sent an ESTIMATE whose quaternion has not the length 1")
        sd = row[:, 16:25]
        if not (np.abs(vel_n) < _FASTEST).all() or (np.abs(row[:, 10:16]) > _LARGEST_BIAS).any():
            self._refuse("sent an ESTIMATE whose velocity or bias is that of no aircraft")
        if (sd <= 0).any() or (sd > _LARGEST_SD).any():
            self._refuse(
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
            self._refuse(f"sent {frame.name} with {wrong}")
        return wanted

    def _refuse(self, what: str) -> NoReturn:
        """End the session: a client did what it must not, in words that follow "the client"."""
        self.ended = self._commands.ended = text = f"the client {what}"
        self.close(text, good=False)
        raise EstimatorStoppedError(text)


_SENT = ("HELLO", "ESTIMATE", "ATTITUDE", "SURFACES", "DONE")
