"""Client of a flight of `bench serve`: receive sensors, send an estimate or steering commands.

It is short, and the reference for clients in other languages; `flight_client.c` beside it is the same in C.
"""

from __future__ import annotations

import socket
from collections.abc import Iterator, Sequence
from typing import Self

from bench.io.streams.frames import make_frame
from bench.plugins.hil.flight_messages import (
    ATTITUDE,
    DONE,
    END,
    ESTIMATE,
    HELLO,
    START,
    SURFACES,
    TURN,
    VERSION,
    FlightFrame,
    FrameReader,
    pack,
)

UNKNOWN = float("nan")


class FlightClient:
    """A connection to a flight; a context manager that closes it.

    Parameters
    ----------
    port : int
        Of the server.
    host : str
        Its address.

    Raises
    ------
    OSError
        If there is no server.
    ConnectionError
        If it rejects the client, in its words.

    Examples
    --------
    ``with FlightClient(5700) as flight: for t, frames in flight.turns(): flight.estimate(...)``
    """

    def __init__(self, port: int, host: str = "127.0.0.1") -> None:
        self._line = socket.create_connection((host, port))
        self._line.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        self._reader, self._frames = FrameReader(), list[FlightFrame]()
        self._number, self._waiting = 0, bytearray()
        self._t = 0.0
        self.end = ""
        """The last words of the server."""
        try:
            self._send(HELLO, VERSION)
            self._flush()
            hello, start = self._expect(HELLO), self._expect(START)
        except BaseException:
            self._line.close()
            raise
        self.hello = hello.values()
        """Version, IMU rate [Hz], time between turns [s], duration [s], antenna x, y, z [m], ground height
        [m], date [years]; NaN if not known."""
        self.start = start.values() if start.valid else ()
        """t, lla, vel_n, q_nb, and nine standard deviations; empty if the start is not told."""

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *exc: object) -> None:
        self._line.close()

    def turns(self) -> Iterator[tuple[float, list[FlightFrame]]]:
        """Yield the time [s] and the data since the last turn, until the flight ends.

        What is given meanwhile is sent when the next turn is asked for.
        """
        while True:
            come = list[FlightFrame]()
            while (frame := self._next()).kind not in (TURN, END):
                come.append(frame)
            if frame.kind == END:
                self.end = frame.payload[:-1].decode("utf-8", "replace")
                return
            (self._t,) = frame.values()
            yield self._t, come
            self._send(DONE, self._t)
            self._flush()

    def estimate(
        self,
        lla: Sequence[float],
        vel_n: Sequence[float],
        q_nb: Sequence[float],
        gyro_bias_b: Sequence[float] = (UNKNOWN,) * 3,
        accel_bias_b: Sequence[float] = (UNKNOWN,) * 3,
        sd: Sequence[float] = (UNKNOWN,) * 9,
    ) -> None:
        """Send the estimate of this turn: [rad, rad, m], [m/s], quaternion; biases and sd in SI."""
        self._send(ESTIMATE, self._t, *lla, *vel_n, *q_nb, *gyro_bias_b, *accel_bias_b, *sd)

    def steer_attitude(self, bank: float, pitch: float, throttle: float) -> None:
        """Send targets of bank and pitch [rad] and the throttle, 0 to 1."""
        self._send(ATTITUDE, self._t, bank, pitch, throttle)

    def steer_surfaces(self, aileron: float, elevator: float, rudder: float, throttle: float) -> None:
        """Send surface commands, -1 to 1 with the signs of JSBSim, and the throttle, 0 to 1."""
        self._send(SURFACES, self._t, aileron, elevator, rudder, throttle)

    def _send(self, kind: int, *values: float) -> None:
        self._waiting += make_frame(kind, self._number, pack(*values))
        self._number += 1

    def _flush(self) -> None:
        self._line.sendall(self._waiting)
        self._waiting.clear()

    def _next(self) -> FlightFrame:
        while not self._frames:
            data = self._line.recv(1 << 16)
            if not data:
                raise ConnectionError("the server has closed the connection")
            try:
                self._frames = list(self._reader.take(data))[::-1]
            except ValueError as error:
                raise ConnectionError(f"the server {error}") from None
        return self._frames.pop()

    def _expect(self, kind: int) -> FlightFrame:
        frame = self._next()
        if frame.kind == END:
            raise ConnectionError(frame.payload[:-1].decode("utf-8", "replace"))
        if frame.kind != kind:
            wanted = FlightFrame(kind, b"").name
            raise ConnectionError(
                f"expected {wanted}, received {frame.name}. Is this a 'bench serve' server?"
            )
        return frame
