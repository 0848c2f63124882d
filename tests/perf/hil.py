"""Round trip of a sample with an autopilot in a process of its own, and the speed of a flight by one.

    python -m tests.perf.hil

The stand-in answers without a thought: what is measured is the bench and the socket. The best of three rounds
counts. The round trip is by the clock. The speed is a sample over its CPU time here and its round trip: what
else the machine does is left out of it.
"""

from __future__ import annotations

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
    found = []
    for _ in range(ROUNDS):
        with listen("127.0.0.1", 0, told.append, udp=kind == "json") as server:
            commands = Commands()
            link: Any
            if kind == "json":
                start = np.array([spec.lat, spec.lon, spec.alt])
                link = JsonSession(server, commands, 0.0, 5.0, channels=ARDUPILOT, start=start)
            else:
                channels = ActuatorChannels()
                link = MavlinkSession(
                    server, commands, 0.0, 5.0, channels=channels, truth=False, alt=spec.alt
                )
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
        found.append((trip, 1.0 / rate / (cpu + trip)))
    return min(one[0] for one in found), max(one[1] for one in found)


def timed(exchange: Callable[[Any], None], trips: list[float], spent: list[float]) -> Callable[[Any], None]:
    """Return the exchange of a sample, which stores its duration and the CPU time until then [s]."""

    def run(sample: Any) -> None:
        begun = time.perf_counter()
        exchange(sample)
        trips.append(time.perf_counter() - begun)
        spent.append(time.process_time())

    return run


def measure() -> list[tuple[str, float, float, str, bool]]:
    """Return the rows of `tests.perf.ratios`: what, value, limit, unit, whether higher is better."""
    rows = []
    for kind, name, rate in (("mavlink", "PX4", 250), ("json", "ArduPilot", 400)):
        trip, speed = fly(kind, rate)
        rows += [
            (f"{name}, {rate} Hz: median round trip of a sample", 1e3 * trip, 0.2, "ms", False),
            (f"{name}, {rate} Hz: a sample over CPU time and round trip", speed, 5.0, "x", True),
        ]
    return rows


if __name__ == "__main__":
    if len(sys.argv) > 1:
        {"json": answer_json, "mavlink": answer_mavlink}[sys.argv[1]](int(sys.argv[2]))
    else:
        for what, value, limit, unit, higher in measure():
            print(f"{what:75} {value:.3g} {unit} ({'>=' if higher else '<='} {limit:g})")
