"""Connection of a client during a flight: permitted addresses, time limits, speed of the flight.

An error of the client ends the session with one line.
"""

from __future__ import annotations

import contextlib
import math
import select
import socket
import time
from abc import ABC, abstractmethod
from collections.abc import Callable
from typing import Any, NoReturn

from bench.core.words.exceptions import EstimatorStoppedError
from bench.io.streams.streaming import wait_until
from bench.simulation.flight.guidance.steering import Commands

_BLOCK = 1 << 16
PATIENCE = 2.0  # for the last words to be sent, and for what the client still sends [s]
ALONE = 2.0  # that a client has to begin in while another one waits [s]


class FlightPace:
    """The speed of a flight in relation to the clock."""

    def __init__(self) -> None:
        self._begun = math.nan
        self.latest = 0.0
        """Largest delay behind the rate [s]."""

    def keep(self, t: float, rate: float) -> None:
        """Wait until the flight may continue from a time [s] at a rate."""
        now = time.monotonic()
        if math.isnan(self._begun):
            self._begun = now - t / rate
        due = self._begun + t / rate
        late = now - due
        self.latest = max(self.latest, late)
        self._begun += max(late, 0.0)  # what was lost is not made up by flying faster
        wait_until(due)

    def forget(self) -> None:
        """Begin anew: what has been waited for until now is no delay."""
        self._begun = math.nan


class ClientSession(ABC):
    """The server of one client.

    Parameters
    ----------
    server : socket
        That waits for connections.
    commands : Commands
        What the client wants of the controls is put there.
    rate : float
        Seconds of the flight per second at most; 0 or infinity: as fast as possible.
    patience : float
        Longest silence of a client that is to answer [s].
    """

    def __init__(self, server: socket.socket, commands: Commands, rate: float, patience: float) -> None:
        self._server, self.commands, self.patience = server, commands, patience
        self.rate = rate if 0 < rate < math.inf else 0.0
        self._line: socket.socket | None = None
        self._come = list[Any]()
        self._begins_until: float | None = None  # no other one is looked at until then; None: it has begun
        self.pace = FlightPace()
        self.ended, self.closed = "", False
        """Why the session was ended, in words, and whether the client has closed it."""

    @abstractmethod
    def begin(self) -> None:
        """Process the first messages of a new client."""

    @abstractmethod
    def read(self, data: bytes) -> list[Any]:
        """Return the messages in received bytes; raise a ValueError that describes invalid bytes."""

    @abstractmethod
    def make_end(self, words: str, *, good: bool, known: bool = True) -> bytes:
        """Return the last message to a client; ``known`` is False for a rejected client."""

    @property
    @abstractmethod
    def inside(self) -> bool:
        """Return whether a message has arrived only in part."""

    def wait(self, say: Callable[[str], object]) -> None:
        """Wait for a client with a valid start; send other clients the reason of their rejection.

        A client that does not begin keeps the connection until its time is over, or another client connects.
        """
        while True:
            self._line, address = self._server.accept()
            say(f"a client has come from {address[0]}")
            self._line.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
            self._come.clear()
            self.closed = False
            self._begins_until = time.monotonic() + ALONE
            try:
                self.begin()
            except EstimatorStoppedError as error:
                say(f"{error}; waiting for another")
                self.ended = self.commands.ended = ""
            else:
                self._begins_until = None
                return

    def close(self, words: str, *, good: bool) -> None:
        """Send the last words and close the connection."""
        if self._line is None:
            return
        with contextlib.suppress(OSError):
            self._line.settimeout(PATIENCE)
            self._line.sendall(self.make_end(words, good=good))
            self._line.shutdown(socket.SHUT_WR)
            until = time.monotonic() + PATIENCE
            # what it has sent and nobody read would take the last words from it
            while time.monotonic() < until and self._line.recv(_BLOCK):
                pass
        self._line.close()
        self._line = None

    def send(self, data: bytes) -> None:
        """Send bytes."""
        assert self._line is not None
        try:
            self._line.settimeout(self.patience)
            self._line.sendall(data)
        except TimeoutError:
            self.refuse(f"has taken nothing for {self.patience:g} s")
        except OSError:
            self._lose()

    def receive(self) -> Any:
        """Return the next message; a client that is silent is rejected."""
        found = self.receive_until(time.monotonic() + self.patience)
        if found is None:
            self.refuse(f"has been silent for {self.patience:g} s")
        return found

    def receive_until(self, due: float) -> Any:
        """Return the next message, or None if none arrives by ``due``; meanwhile reject other clients."""
        assert self._line is not None
        while not self._come:
            now = time.monotonic()
            if (left := due - now) <= 0:
                return None
            alone = 0.0 if self._begins_until is None else self._begins_until - now
            places = [self._line] if alone > 0 else [self._line, self._server]
            ready = select.select(places, [], [], min(left, alone) if alone > 0 else left)[0]
            if self._server in ready and self._begins_until is not None:
                self.refuse(f"has not begun in {ALONE:g} s, and another one waits")
            if self._server in ready:
                self._send_away()
            if self._line in ready:
                self._read()
        return self._come.pop()

    def receive_ready(self) -> list[Any]:
        """Return the messages that have arrived, without waiting."""
        assert self._line is not None
        if select.select([self._line], [], [], 0.0)[0]:
            self._read()
        found = self._come[::-1]
        self._come.clear()
        return found

    def refuse(self, what: str) -> NoReturn:
        """End the session because of an error of the client, in words that follow "the client"."""
        self.ended = self.commands.ended = text = f"the client {what}"
        self.close(text, good=False)
        raise EstimatorStoppedError(text)

    def _lose(self, where: str = "") -> NoReturn:
        self.closed = True
        self.refuse(f"has closed the connection{where}")

    def _read(self) -> None:
        assert self._line is not None
        try:
            data = self._line.recv(_BLOCK)
        except OSError:
            data = b""
        if not data:
            self._lose(" in the middle of a message" if self.inside else "")
        try:
            self._come = self.read(data)[::-1] + self._come
        except ValueError as error:
            self.refuse(str(error))

    def _send_away(self) -> None:
        other, _ = self._server.accept()
        with other, contextlib.suppress(OSError):
            other.sendall(self.make_end("another client flies; one at a time", good=False, known=False))
