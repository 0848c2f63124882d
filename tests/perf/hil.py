"""Round trip of a sample with an autopilot in a process of its own, and the speed of a flight by one.

    python -m tests.perf.hil

The stand-in answers without a thought: what is measured is the bench and the socket. The best of three rounds
counts, of the bench and of bare messages of the same kind that go by turns with it. The round trip is by the
clock. The speed is a sample over its CPU time here and its round trip: nothing else the machine does.
"""

from __future__ import annotations

import math
import socket
import struct
import subprocess
import sys
import time
from collections.abc import Callable
from typing import Any

import numpy as np
from pymavlink.dialects.v20 import common as dialect

from bench.core.records.flight_specs import FlightSpec
from bench.io.streams.streaming import listen
from bench.pipeline import autopilot_flight
from bench.plugins.hil.actuator_channels import ARDUPILOT, ActuatorChannels
from bench.plugins.hil.json_session import JsonSession
from bench.plugins.hil.mavlink_session import MavlinkSession
from bench.plugins.hil.served import load_served
from bench.simulation.flight.guidance.steering import Commands
from tests.perf.units import Figure

ROUNDS, SECONDS = 3, 10.0
HIL_SENSOR = 107  # message of common.xml


def answer_mavlink(port: int) -> None:
    """Answer each HIL_SENSOR with the same controls."""
    mav = dialect.MAVLink(None)
    controls = dialect.MAVLink_hil_actuator_controls_message(0, [0.0] * 4 + [0.5] + [0.0] * 11, 129, 1).pack(
        mav
    )
    with socket.create_connection(("127.0.0.1", port)) as line:
        line.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        line.sendall(dialect.MAVLink_heartbeat_message(0, 12, 0, 0, 0, 3).pack(mav))
        held = b""
        while data := line.recv(1 << 16):
            held += data
            while len(held) > 10 and len(held) >= 12 + held[1]:  # begin, size, flags, number, from, kind, sum
                kind, held = int.from_bytes(held[7:10], "little"), held[12 + held[1] :]
                if kind == HIL_SENSOR:
                    line.sendall(controls)


def answer_json(port: int) -> None:
    """Answer each line with the next frame."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as line:
        line.connect(("127.0.0.1", port))
        line.settimeout(5.0)
        for frame in range(1 << 30):
            line.send(struct.pack("<HHI16H", 18458, 400, frame, 1500, 1500, 1500, *[1500] * 13))
            try:
                line.recv(4096)
            except OSError:
                return


def fly(kind: str, rate: int) -> tuple[float, float]:
    """Return the median round trip of a sample [s], and the flight time over the time it took."""
    profile = load_served("s-turns", {"duration_s": SECONDS, "rate_hz": rate, "evaluation.from_s": 1.0})
    spec, told = profile.flight, list[str]()
    assert isinstance(spec, FlightSpec)
    with listen("127.0.0.1", 0, told.append, udp=kind == "json") as server:
        commands = Commands()
        link: Any
        if kind == "json":
            start = np.array([spec.lat, spec.lon, spec.alt])
            link = JsonSession(server, commands, 0.0, 5.0, channels=ARDUPILOT, start=start)
        else:
            channels = ActuatorChannels()
            link = MavlinkSession(server, commands, 0.0, 5.0, channels=channels, truth=False, alt=spec.alt)
        trips, spent = list[float](), list[float]()
        link.exchange = timed(link.exchange, trips, spent)
        other = [sys.executable, "-m", "tests.perf.hil", kind, str(server.getsockname()[1])]
        with subprocess.Popen(other) as stand_in:
            link.wait(told.append)
            flown = autopilot_flight.fly(profile, 0, link, told.append)
            link.close("over", good=True)
            stand_in.kill()
    assert not flown.ended, flown.ended
    half = len(trips) // 2  # the first seconds are real time and compiling
    trip, cpu = float(np.median(trips[half:])), (spent[-1] - spent[half]) / (len(spent) - 1 - half)
    return trip, 1.0 / rate / (cpu + trip)


def timed(exchange: Callable[[Any], None], trips: list[float], spent: list[float]) -> Callable[[Any], None]:
    """Return the exchange of a sample, which stores its duration and the CPU time until then [s]."""

    def run(sample: Any) -> None:
        begun = time.perf_counter()
        exchange(sample)
        trips.append(time.perf_counter() - begun)
        spent.append(time.process_time())

    return run


def bounce(kind: str) -> float:
    """Return the median round trip of bare messages of 100 bytes with a process of its own [s]."""
    trips = []
    datagrams = kind == "json"
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM if datagrams else socket.SOCK_STREAM) as door:
        door.bind(("127.0.0.1", 0))
        if not datagrams:
            door.listen(1)
        other = [sys.executable, "-m", "tests.perf.hil", f"bare-{kind}", str(door.getsockname()[1])]
        with subprocess.Popen(other) as stand_in:
            line, place = (door, door.recvfrom(100)[1]) if datagrams else door.accept()
            with line:
                if not datagrams:
                    line.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
                for _ in range(3000):
                    begun = time.perf_counter()
                    line.sendto(bytes(100), place) if datagrams else line.sendall(bytes(100))
                    line.recv(100)
                    trips.append(time.perf_counter() - begun)
            stand_in.kill()
    return float(np.median(trips[500:]))


def bounce_back(kind: str, port: int) -> None:
    """Send each message back."""
    with socket.socket(
        socket.AF_INET, socket.SOCK_DGRAM if kind == "bare-json" else socket.SOCK_STREAM
    ) as line:
        line.connect(("127.0.0.1", port))
        if kind == "bare-json":
            line.send(b"here")
        else:
            line.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        while data := line.recv(100):
            line.send(data)


def measure() -> list[Figure]:
    """Return the rows of `tests.perf.ratios`."""
    rows = []
    for kind, name, rate in (("mavlink", "PX4", 250), ("json", "ArduPilot", 400)):
        found = np.array([[*fly(kind, rate), bounce(kind)] for _ in range(ROUNDS)])
        trip, bare = float(found[:, 0].min()), float(found[:, 2].min())
        speed, spread = float(found[:, 1].max()), float(np.median(found[:, 0]) / trip)
        rows += [
            Figure(
                f"{name}, {rate} Hz: round trip of a sample / of a bare message",
                trip / bare,
                9.0,
                spread=spread,
            ),
            Figure(
                f"{name}, {rate} Hz: flight time over CPU time and round trips", speed, math.inf, "x", True
            ),
        ]
    return rows


if __name__ == "__main__":
    if len(sys.argv) > 1 and sys.argv[1].startswith("bare-"):
        bounce_back(sys.argv[1], int(sys.argv[2]))
    elif len(sys.argv) > 1:
        {"json": answer_json, "mavlink": answer_mavlink}[sys.argv[1]](int(sys.argv[2]))
    else:
        for one in measure():
            print(f"{one.what:75} {one.value:.3g} {one.unit}")
