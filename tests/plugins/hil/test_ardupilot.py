"""A stand-in for ArduPilot's SITL, after SIM_JSON.cpp, flies by JSON, restarts, and falls silent."""

from __future__ import annotations

import json
import math
import socket
import struct
import threading
import time

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from bench.core.mathematics import rotation
from bench.core.words.exceptions import ConfigError
from bench.plugins.hil import serving
from bench.plugins.hil.actuator_channels import ARDUPILOT, ActuatorChannels
from tests.plugins.hil.test_serve import Server, write_straight

BANK = 0.2  # what it flies [rad]


class Sitl(threading.Thread):
    """Sends a packet of servos, waits for a line of JSON, and sends it again after a second without one.

    ``told`` are the lines; ``resets`` counts times that go back. It flies for so many frames.
    """

    def __init__(self, port, frames, magic=18458):
        super().__init__(daemon=True)
        self._line = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._line.settimeout(0.1)
        self._to, self._magic, self._frames = ("127.0.0.1", port), magic, frames
        self.frame, self.told, self.resets, self.sent = 0, [], 0, 0
        self.roll = self.pitch = self._sum = self.time = self._last = 0.0
        self.pulses = [1500, 1500, 1000, 1500] + [0] * (28 if magic == 29569 else 12)
        self.start()

    def output_servos(self):
        self._line.sendto(
            struct.pack(f"<HHI{len(self.pulses)}H", self._magic, 400, self.frame, *self.pulses), self._to
        )
        self.sent += 1

    def receive(self):
        """As recv_fdm: the text between the last two line feeds."""
        waited = 0.0
        while self._frames:
            try:
                *_, line, rest = self._line.recv(65000).split(b"\n")
                assert rest == b""
                return json.loads(line)
            except TimeoutError:
                waited += 0.1
                if waited > 1.0:
                    waited = 0.0
                    self.output_servos()
        return None

    def run(self):
        with self._line:
            self.fly()

    def fly(self):
        while self.frame < self._frames:
            self.output_servos()
            if (state := self.receive()) is None:
                return
            self.told.append(state)
            if state["timestamp"] < self._last:
                self.resets += 1
            else:
                self.time += state["timestamp"] - self._last
                self.steer(state, state["timestamp"] - self._last)
            self._last = state["timestamp"]
            self.frame += 1
        if self._frames:  # it goes on
            self.output_servos()

    def steer(self, state, dt):
        p, q, r = state["imu"]["gyro"]
        self.roll += p * dt
        self.pitch += (q * math.cos(self.roll) - r * math.sin(self.roll)) * dt
        self._sum += self.pitch * dt
        aileron = 0.4 * (BANK - self.roll) - 0.06 * p
        elevator = -(0.6 * self.pitch + 0.1 * q + 0.4 * self._sum)  # nose up
        self.pulses[:4] = [round(1500 + 500 * aileron), round(1500 + 500 * elevator), 1500, 1500]

    def end(self):
        self._frames = 0


@pytest.fixture(scope="module")
def path(tmp_path_factory):
    return write_straight(tmp_path_factory.mktemp("json") / "straight.toml", 20.0)


def serve(path, seconds, rate=400, **options):
    changes = {"duration_s": seconds, "rate_hz": rate}
    return Server(path, changes, ardupilot=ARDUPILOT, **options)


def column(told, *keys):
    for key in keys:
        told = [one[key] for one in told]
    return np.array(told)


def test_sitl_flies_by_json_and_gets_the_truth_and_the_imu_that_is_recorded(path):
    server = serve(path, 8.0)
    assert server.listen() == "start SITL with --home 47.2600000,11.3400000,1200.00,85.0"
    sitl = Sitl(server.port, 3200)
    served = server.join()
    sitl.join(5.0)
    truth, imu = served.result.truth, served.result.sensed.data.imu
    assert (served.ended, served.flown, len(sitl.told)) == ("", 8.0, 3200)
    roll, pitch = rotation.to_euler(truth.q_nb)[:2]
    assert_allclose(roll[truth.t > 5.0], BANK, atol=0.06)
    assert_allclose(pitch[-1], pitch[0], atol=0.06)
    assert served.result.provenance["served"]["messages"] == "ArduPilot JSON"

    told = sitl.told
    assert_allclose(column(told, "timestamp"), truth.t[1:], atol=1e-6)
    assert_allclose(column(told, "imu", "gyro"), imu.dtheta_b * 400.0, rtol=1e-8, atol=1e-9)
    assert_allclose(column(told, "imu", "accel_body"), imu.dvel_b * 400.0, rtol=1e-8, atol=1e-8)
    assert_allclose(column(told, "velocity"), truth.vel_n[1:], rtol=1e-7, atol=1e-8)
    q_nb = column(told, "quaternion")
    assert_allclose(q_nb * np.sign(np.sum(q_nb * truth.q_nb[1:], axis=1))[:, None], truth.q_nb[1:], atol=1e-8)
    moved = np.diff(column(told, "position"), axis=0) * 400.0  # the derivative of position is the velocity
    assert_allclose(moved, 0.5 * (truth.vel_n[1:-1] + truth.vel_n[2:]), atol=0.005)
    assert_allclose(column(told, "position")[:, 2], 1200.0 - truth.lla[1:, 2], atol=1e-6)
    assert_allclose(column(told, "airspeed"), truth.air.airspeed_calibrated[1:], rtol=1e-8)


def test_time_goes_back_for_a_sitl_that_restarts(path):
    """Its frames count from 0 again, from another port: it gets the begin of the flight."""
    server = serve(path, 3.0)
    first = Sitl(server.port, 400)
    first.join(60.0)
    second = Sitl(server.port, 1200)
    served = server.join()
    second.join(5.0)
    assert (served.ended, served.flown) == ("", 3.0)
    assert (first.told[-1]["timestamp"], second.told[0]["timestamp"]) == (1.0, 0.0025)
    lines = [server.listen() for _ in range(2)]
    assert lines[1] == "the client has restarted after its frame 400; the flight begins anew"


def test_sitl_stays_while_bench_restarts(path):
    """It sends its frame again until there is one that answers, and sees the time go back."""
    server = serve(path, 1.5)
    sitl = Sitl(server.port, 1200)
    assert server.join().flown == 1.5
    again = serve(path, 1.5, address=f"127.0.0.1:{server.port}")
    assert again.join().flown == 1.5
    sitl.join(5.0)
    assert (sitl.resets, len(sitl.told)) == (1, 1200)
    assert_allclose(sitl.time, 1.5 + 1.5 - 0.0025, atol=1e-6)


class Deaf(Sitl):
    """Does not hear one reply, and sends one packet twice."""

    def receive(self):
        state = super().receive()
        if self.frame == 200 and state is not None and self.sent == 201:
            return super().receive()
        if self.frame == 300 and self.sent == 302:
            self.output_servos()
        return state


def test_a_lost_reply_is_sent_again_and_a_packet_that_comes_twice_moves_nothing(path):
    server = serve(path, 1.5)
    sitl = Deaf(server.port, 600)
    assert server.join().ended == ""
    sitl.join(5.0)
    assert_allclose(column(sitl.told, "timestamp"), np.arange(1, 601) / 400.0, atol=1e-6)
    assert sitl.sent == 603


def test_more_outputs_and_their_assignment(path):
    """The controls of 32 outputs; a servo that is not among 16 is said."""
    server = serve(path, 1.5)
    sitl = Sitl(server.port, 600, magic=29569)
    served = server.join()
    sitl.join(5.0)
    controls = served.result.truth.controls
    assert served.ended == ""
    assert_allclose(controls.throttle[-1], 0.5, atol=1e-6)
    assert_allclose(controls.rudder[-1], 0.0, atol=1e-6)
    assert_allclose(controls.elevator[-20:], -(np.array(sitl.pulses[1]) - 1500) / 500.0, atol=0.02)
    far = Server(path, {"duration_s": 2.0, "rate_hz": 400}, ardupilot=ActuatorChannels(17, 2, 3, 4))
    Sitl(far.port, 10)
    with pytest.raises(Exception, match="sends 16 outputs, --channels has 17; SERVO_32_ENABLE"):
        far.join()


def test_until_it_gives_power_the_aircraft_holds(path):
    class Disarmed(Sitl):
        def steer(self, state, dt):
            self.pulses[:4] = [1900, 1100, 1000, 1900]

    server = serve(path, 2.0)
    sitl = Disarmed(server.port, 800)
    truth = server.join().result.truth
    sitl.join(5.0)
    assert_allclose(truth.lla[-1, 2], truth.lla[0, 2], atol=0.5)
    assert_allclose(rotation.to_euler(truth.q_nb[-1])[0], 0.0, atol=0.05)


@pytest.mark.parametrize(
    ("pulse", "words"),
    [
        (65535, "the client sent 65535 us in output 1; a servo takes 1000 to 2000 us"),
        (None, "the client has been silent for 1 s; 3 datagrams were no servo packets"),
    ],
)
def test_what_sitl_does_wrong_ends_the_flight_with_a_line(pulse, words, path):
    class Wrong(Sitl):
        def steer(self, state, dt):
            super().steer(state, dt)
            if state["timestamp"] > 1.5 and pulse:
                self.pulses[0] = pulse
            elif state["timestamp"] > 1.5:
                for data in (b"GET / HTTP/1.1", struct.pack("<HHI15H", 18458, 400, 9, *[1500] * 15), b""):
                    self._line.sendto(data, self._to)
                self.frame = self._frames = 0

    server = serve(path, 20.0, patience=1.0)
    begun = time.monotonic()
    sitl = Wrong(server.port, 8000)
    served = server.join()
    sitl.end()
    sitl.join(5.0)
    assert (served.ended, served.flown > 1.4) == (words, True)
    assert time.monotonic() - begun < 60.0


def test_another_on_the_same_port_does_not_disturb(path):
    server = serve(path, 2.0)
    sitl = Sitl(server.port, 800)
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as other:
        while sitl.is_alive():
            other.sendto(
                struct.pack("<HHI16H", 18458, 400, 100_000, *[2000] * 16), ("127.0.0.1", server.port)
            )
            time.sleep(0.02)
    assert server.join().ended == ""
    assert_array_equal(column(sitl.told, "timestamp"), np.round(np.arange(1, 801) / 400.0, 6))


def test_an_autopilot_needs_a_length_and_an_aircraft_in_the_air(path):
    with pytest.raises(ConfigError, match="Set the duration"):
        serving.serve(path, overrides={"duration_s": None}, ardupilot=ARDUPILOT)
    with pytest.raises(ConfigError, match="commands fly in the air; this flight begins on the ground"):
        serving.serve("circuit", overrides={"duration_s": 100.0}, ardupilot=ARDUPILOT)
