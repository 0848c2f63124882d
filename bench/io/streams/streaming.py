"""Send the sensor data of a run to a socket at the pace of its arrival."""

from __future__ import annotations

import contextlib
import errno
import ipaddress
import math
import socket
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass

from bench.core.words.exceptions import ConfigError
from bench.io.exports import ExportData
from bench.io.streams.frames import make_messages

_ROUGH = 0.002  # a sleep may last this much too long; the rest is waited by polling the clock [s]
_HIGHEST = 65535


@dataclass(frozen=True, slots=True)
class Streamed:
    """Summary of what was sent."""

    messages: int
    seconds: float  # duration of sending [s]
    latest: float | None  # largest delay of a message [s]; None if sent without pace


def stream(
    run: ExportData, kind: str, address: str, *, rate: float, remote: bool, say: Callable[[str], object]
) -> Streamed:
    """Send the sensors of a run as messages.

    Parameters
    ----------
    run : Outgoing
        The sensors.
    kind : str
        "udp": send each message as a datagram to the address; "tcp": wait for one connection at the address.
    address : str
        ``IP:PORT``; TCP port 0 takes any free port.
    rate : float
        Seconds of the run per second; 0 or infinity: as fast as possible.
    remote : bool
        Allow the address of another machine.
    say : callable
        Called with a line that names the address, before the first message.

    Raises
    ------
    ConfigError
        If the address or the rate is wrong.
    OSError
        If the address cannot be used, or the other side closes the connection before the end.
    """
    if math.isnan(rate) or rate < 0:
        raise ConfigError(f"--rate {rate:g} must not be negative; 0 or inf sends as fast as possible")
    host, port = parse_address(f"--{kind} {address}", address, remote=remote, lowest=int(kind == "udp"))
    paced = 0 < rate < math.inf
    sent, late = 0, 0.0
    with _open_socket(kind, host, port, say) as send:
        begun = time.monotonic()
        first: float | None = None
        for arrival, message in make_messages(run):
            first = arrival if first is None else first
            if paced:
                due = begun + (arrival - first) / rate
                wait_until(due)
                late = max(late, time.monotonic() - due)
            try:
                send(message)
            except (ConnectionError, BrokenPipeError):
                text = f"the other side closed the connection after {sent} messages"
                raise OSError(errno.ECONNRESET, text, f"{kind} {address}") from None
            except OSError as error:
                raise OSError(error.errno, error.strerror, f"{kind} {address}") from None
            sent += 1
        return Streamed(sent, time.monotonic() - begun, late if paced else None)


def parse_address(option: str, address: str, *, remote: bool, lowest: int = 0) -> tuple[str, int]:
    """Return host and port of ``IP:PORT``; only loopback addresses unless ``remote`` is true.

    Raises
    ------
    ConfigError
        In the words of ``option``.
    """
    host, colon, text = address.rpartition(":")
    if not colon or not text.isascii() or not text.isdecimal() or not lowest <= int(text) <= _HIGHEST:
        raise ConfigError(f"{option}: must be IP:PORT, for example 127.0.0.1:5600")
    name = host.removeprefix("[").removesuffix("]")
    name = "127.0.0.1" if name == "localhost" else name
    try:
        ip = ipaddress.ip_address(name)
    except ValueError:
        raise ConfigError(f"{option}: {host!r} is not an IP address; 127.0.0.1 is this machine") from None
    if not ip.is_loopback and not remote:
        raise ConfigError(
            f"{option}: the address is not on this machine; --allow-remote permits sending to it"
        )
    return name, int(text)


@contextlib.contextmanager
def _open_socket(
    kind: str, host: str, port: int, say: Callable[[str], object]
) -> Iterator[Callable[[bytes], object]]:
    """Open the socket and provide the function that sends one message."""
    family = socket.AF_INET6 if ":" in host else socket.AF_INET
    shown = f"[{host}]" if ":" in host else host
    if kind == "udp":
        with socket.socket(family, socket.SOCK_DGRAM) as out:
            say(f"sending to {shown}:{port}, a datagram per message; Ctrl-C ends it")
            yield lambda message: out.sendto(message, (host, port))
        return
    with listen(host, port, say) as server:
        client, _ = server.accept()
        with client:
            client.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
            yield client.sendall


@contextlib.contextmanager
def listen(
    host: str, port: int, say: Callable[[str], object], *, udp: bool = False
) -> Iterator[socket.socket]:
    """Provide a socket that waits for connections; call ``say`` with a message that contains its address.

    With ``udp`` it waits for datagrams.

    Raises
    ------
    OSError
        If the address cannot be used.
    """
    family, shown = (socket.AF_INET6, f"[{host}]") if ":" in host else (socket.AF_INET, host)
    kind = "udp" if udp else "tcp"
    with socket.socket(family, socket.SOCK_DGRAM if udp else socket.SOCK_STREAM) as server:
        if not udp:  # else two programs could share the port
            server.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            server.bind((host, port))
        except OSError as error:
            raise OSError(error.errno, error.strerror, f"{kind} {shown}:{port}") from None
        if not udp:
            server.listen(1)
        say(f"waiting for a connection on {shown}:{server.getsockname()[1]}; Ctrl-C ends it")
        yield server


def wait_until(due: float) -> None:
    """Wait until a time of ``time.monotonic`` [s]."""
    left = due - time.monotonic()
    if left > _ROUGH:
        time.sleep(left - _ROUGH)
    while time.monotonic() < due:
        time.sleep(0)
