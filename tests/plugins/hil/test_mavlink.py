"""An autopilot of our own flies through MAVLink; what it was told is the recorded sensors in other units."""

from __future__ import annotations

import contextlib
import math
import socket
import threading
import time
from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from pymavlink.dialects.v20 import common as dialect

from bench.core.mathematics import rotation
from bench.core.words.exceptions import ConfigError
from bench.navigation.engine.kept_rows import take_rows
from bench.pipeline.autopilot_flight import Sample
from bench.plugins.hil import serving
from bench.plugins.hil.actuator_channels import ActuatorChannels
from bench.plugins.hil.mavlink_session import MavlinkSession
from bench.simulation.flight.guidance.steering import Commands
from bench.simulation.sampled.sample_motion import SampleMotion
from tests.plugins.hil.test_serve import Server, write_straight

BANK = 0.2  # what it flies [rad]


class Autopilot(threading.Thread):
    """Flies a bank and the pitch of the begin by the gyros alone; ``told`` is what it got, by kind."""

    def __init__(self, port, controls=None, armed_at=0.0):
        super().__init__(daemon=True)
        self._line = socket.create_connection(("127.0.0.1", port))
        self._mav, self.told, self.order = dialect.MAVLink(None), {}, []
        self._controls, self._armed_at = controls, armed_at
        self.roll = self.pitch = self._sum = 0.0
        self.start()

    def send(self, message):
        self._line.sendall(message.pack(self._mav))

    def run(self):
        # as PX4 begins: both threads at once, a heartbeat of the sender and the wish for the truth
        self.send(dialect.MAVLink_command_long_message(0, 0, dialect.MAV_CMD_SET_MESSAGE_INTERVAL, 0,
                                                       115, 5000, 0, 0, 0, 0, 0))  # fmt: skip
        self.send(dialect.MAVLink_heartbeat_message(0, dialect.MAV_AUTOPILOT_PX4, 0, 0, 0, 3))
        last = 0.0
        while data := self._line.recv(1 << 16):
            for message in self._mav.parse_buffer(data) or []:
                self.told.setdefault(message.get_type(), []).append(message)
                self.order.append(message)
                if message.get_type() == "HIL_SENSOR":
                    t = 1e-6 * message.time_usec
                    self.steer(t, t - last, message)
                    last = t
        self._line.close()

    def steer(self, t, dt, sensed):
        self.roll += sensed.xgyro * dt
        self.pitch += (sensed.ygyro * math.cos(self.roll) - sensed.zgyro * math.sin(self.roll)) * dt
        self._sum += self.pitch * dt
        controls, armed = [0.0] * 16, t > self._armed_at
        if armed:
            controls[5] = -(0.4 * (BANK - self.roll) - 0.06 * sensed.xgyro)  # aileron of 1033_jsbsim_rascal
            controls[7] = -(0.6 * self.pitch + 0.1 * sensed.ygyro + 0.4 * self._sum)
            controls[4] = 0.5
        if self._controls is not None:
            controls = self._controls
        flags = 1 | (128 if armed else 0)
        self.send(dialect.MAVLink_hil_actuator_controls_message(round(1e6 * t), controls, flags, 1))


@pytest.fixture(scope="module")
def path(tmp_path_factory):
    return write_straight(tmp_path_factory.mktemp("mavlink") / "straight.toml", 20.0)


def serve(path, seconds, changes=None, **options):
    changes = {
        "duration_s": seconds,
        "guidance.period_s": 0.05,
        "sensors.airspeed": "ms4525do",
        "sensors.mag.latency_s": 0.033,
        **(changes or {}),
    }
    return Server(path, changes, mavlink=ActuatorChannels(), **options)


def columns(messages, *names):
    return np.array([[getattr(one, name) for name in names] for one in messages])


def find_sample(imu, arrival):
    """The sample of the IMU whose HIL_SENSOR brings what has arrived."""
    return np.searchsorted(imu.t, arrival - 1e-9)


def test_an_autopilot_flies_by_mavlink_and_gets_what_is_recorded(path):
    """Expected by the units of common.xml and by formulas of their own, not by the code that sends."""
    server = serve(path, 20.0)
    autopilot = Autopilot(server.port, armed_at=0.5)
    served = server.join()
    autopilot.join(5.0)
    truth, told, data = served.result.truth, autopilot.told, served.result.sensed.data
    assert (served.ended, served.flown) == ("", 20.0)
    roll, pitch = rotation.to_euler(truth.q_nb)[:2]
    assert_allclose(roll[truth.t > 5.0], BANK, atol=0.06)
    assert_allclose(pitch[-1], pitch[0], atol=0.06)
    assert served.result.provenance["served"]["messages"] == "MAVLink"

    sensor, imu = told["HIL_SENSOR"], data.imu
    assert_array_equal(columns(sensor, "time_usec")[:, 0], np.rint(1e6 * imu.t))
    assert {one.id for one in sensor} == {0}  # PX4 takes its time from the first one alone
    rates, forces = columns(sensor, "xgyro", "ygyro", "zgyro"), columns(sensor, "xacc", "yacc", "zacc")
    assert_allclose(rates, imu.dtheta_b * 100.0, rtol=1e-6, atol=1e-7)
    assert_allclose(forces, imu.dvel_b * 100.0, rtol=1e-6, atol=1e-6)
    updated = columns(sensor, "fields_updated")[:, 0].astype(int)
    assert_array_equal(updated & 0b111111, 0b111111)
    for record, bits in ((data.mag, 0x1C0), (data.baro, 0x1A00), (data.airspeed, 0x400)):
        come = record.t_arrival <= 20.0 + 1e-9
        assert_array_equal(np.flatnonzero(updated & bits == bits), find_sample(imu, record.t_arrival[come]))
    field = columns(sensor, "xmag", "ymag", "zmag")[updated & 0x1C0 > 0]
    assert_allclose(field, 1e4 * data.mag.field_b[: len(field)], rtol=1e-6)
    alt = data.baro.alt_baro[: (updated & 0x1A00 > 0).sum()]
    pressure, pressure_alt, temperature = columns(sensor, "abs_pressure", "pressure_alt", "temperature")[
        updated & 0x1A00 > 0
    ].T
    assert_allclose(pressure, 1013.25 * (1.0 - 2.25577e-5 * alt) ** 5.25588, rtol=2e-6)  # ICAO Doc 7488
    assert_allclose(pressure_alt, alt, rtol=1e-6)
    assert_allclose(temperature, 15.0 - 0.0065 * alt, atol=1e-4)
    speed = data.airspeed.airspeed_true[: (updated & 0x400 > 0).sum()]
    density = 1.225 * (1.0 - 2.25577e-5 * 1200.0) ** 4.25588
    impact = columns(sensor, "diff_pressure")[updated & 0x400 > 0][:, 0]
    assert_allclose(impact, 0.5 * density * speed**2 / 100.0, rtol=0.01)  # incompressible

    fixes = data.fixes.take(data.fixes.t_arrival <= 20.0 + 1e-9)
    place = columns(told["HIL_GPS"], "lat", "lon", "alt") * [1e-7, 1e-7, 1e-3]
    assert_allclose(place[:, :2], np.degrees(fixes.lla[:, :2]), atol=0.6e-7)
    assert_allclose(place[:, 2], fixes.lla[:, 2], atol=0.6e-3)
    moved = columns(told["HIL_GPS"], "vn", "ve", "vd", "vel") / 100.0
    assert_allclose(moved[:, :3], fixes.vel_n, atol=0.006)
    assert_allclose(moved[:, 3], np.hypot(*fixes.vel_n[:, :2].T), atol=0.006)
    course = np.degrees(np.arctan2(fixes.vel_n[:, 1], fixes.vel_n[:, 0])) % 360.0
    assert_allclose(columns(told["HIL_GPS"], "cog")[:, 0] / 100.0, course, atol=0.006)
    north, east, down = np.diagonal(fixes.cov_pos_n, axis1=1, axis2=2).T
    accuracy = columns(told["HIL_GPS"], "eph", "epv") / 100.0  # cm to PX4
    assert_allclose(accuracy, np.sqrt([north + east, down]).T, atol=0.006)
    assert {(one.fix_type, one.satellites_visible) for one in told["HIL_GPS"]} == {(3, 255)}

    assert "HIL_STATE_QUATERNION" not in told  # though it has asked for it
    assert len(told["HEARTBEAT"]) == 21
    assert [one.text for one in told["STATUSTEXT"]] == ["the flight is over"]


def times(messages, *kinds):
    return np.array([1e-6 * one.time_usec for one in messages if one.get_type() in kinds])


@pytest.fixture(scope="module")
def flown(path):
    """Two seconds without a barometer; a fix arrives 0.12 s after its time, in the middle of a turn."""
    server = serve(path, 2.0, {"sensors.gnss.latency_s": 0.12, "sensors.baro": None}, truth=True)
    autopilot = Autopilot(server.port)
    served = server.join()
    autopilot.join(5.0)
    return served.result.sensed, autopilot, served.result.truth


def test_fixes_and_truth_come_just_before_the_first_sample_at_their_arrival(flown):
    data, autopilot = flown[0].data, flown[1]
    order = [one for one in autopilot.order if one.get_type().startswith("HIL")]
    sensed = np.array([one.get_type() == "HIL_SENSOR" for one in order])
    assert sensed[-1]
    following = np.minimum.accumulate(np.where(sensed, times(order, *autopilot.told), np.inf)[::-1])[::-1]
    of = {kind: [one.get_type() == kind for one in order] for kind in autopilot.told}
    arrival = data.fixes.t_arrival[data.fixes.t_arrival <= 2.0 + 1e-9]
    assert len(arrival) >= 4
    assert_allclose(following[of["HIL_GPS"]], data.imu.t[find_sample(data.imu, arrival)], atol=1e-6)
    assert_allclose(following[of["HIL_STATE_QUATERNION"]], times(order, "HIL_STATE_QUATERNION"), atol=1e-6)


def test_without_a_barometer_the_air_is_that_at_the_height_of_the_start(flown):
    """Incompressible: 1.3e-3 too little at 25 m/s, and 0.1 m is 1e-5 of the density."""
    data, told = flown[0].data, flown[1].told["HIL_SENSOR"]
    updated = columns(told, "fields_updated")[:, 0].astype(int)
    impact = columns(told, "diff_pressure")[updated & 0x400 > 0, 0]
    density = 1.225 * (1.0 - 2.25577e-5 * 1200.0) ** 4.25588
    assert_allclose(
        impact, 0.5 * density * data.airspeed.airspeed_true[: len(impact)] ** 2 / 100.0, rtol=3e-3
    )
    assert not (updated & 0x1A00).any()


def talk(data, truth):
    """Give a record to an autopilot sample by sample; return what it was told, by kind."""
    fixes = data.fixes
    with socket.create_server(("127.0.0.1", 0)) as server:
        autopilot = Autopilot(server.getsockname()[1])
        options = {"channels": ActuatorChannels(), "truth": False, "alt": 1200.0}
        session = MavlinkSession(server, Commands(), 100.0, 5.0, **options)
        session.wait(lambda text: None)
        for k in range(len(data.imu.t)):
            come = [
                (name, record, row)
                for name, record in (("mag", data.mag), ("fixes", fixes))
                for row in range(len(record.t))
                if find_sample(data.imu, record.t_arrival[row]) == k
            ]
            motion = SampleMotion(*(getattr(truth, name)[k + 1] for name in ("t", "lla", "vel_n", "q_nb")),
                                  truth.dtheta_b[k], truth.dvel_b[k])  # fmt: skip
            session.exchange(Sample(motion, np.zeros(14), take_rows(data.imu, slice(k, k + 1)), come))
        session.close("over", good=True)
    autopilot.join(5.0)
    return autopilot.told


def test_a_sample_of_the_imu_that_does_not_count_is_not_sent(flown):
    """What has arrived meanwhile is told with the next one."""
    data, kept = flown[0].data, np.ones(200, bool)
    kept[90:111] = kept[195:] = False
    increments = (np.where(kept[:, None], one, np.nan) for one in (data.imu.dtheta_b, data.imu.dvel_b))
    imu = replace(data.imu, **dict(zip(("dtheta_b", "dvel_b"), increments, strict=True)), valid=kept)
    gave = talk(replace(data, imu=imu), flown[2])
    told = gave["HIL_SENSOR"]
    assert_allclose(times(told, "HIL_SENSOR"), imu.t[kept], atol=1e-6)
    assert np.isfinite(columns(told, "xacc", "ygyro")).all()
    assert told[90].fields_updated & 0x1C0
    assert len(gave["HIL_GPS"]) == (data.fixes.t_arrival <= 2.0 + 1e-9).sum()


def test_a_fix_that_is_not_whole_is_told_as_none(flown):
    """HIL_GPS has no value for a velocity that is not known: PX4 would take 0 for one. A position without
    its covariance is told with the largest that it holds."""
    sensed, fixes = flown[0], flown[0].data.fixes
    vel_n, cov, lla = fixes.vel_n.copy(), fixes.cov_pos_n.copy(), fixes.lla.copy()
    vel_n[0], vel_n[1, 2], lla[2, 0], cov[3, 1, 1] = np.nan, np.nan, np.inf, np.nan
    data = replace(sensed.data, fixes=replace(fixes, vel_n=vel_n, lla=lla, cov_pos_n=cov))
    told = talk(data, flown[2])["HIL_GPS"]
    assert len(told) == (fixes.t_arrival <= 2.0 + 1e-9).sum()
    assert [one.fix_type for one in told[:5]] == [0, 0, 0, 3, 3]
    assert_array_equal(columns(told[:3], "lat", "lon", "vn", "vd", "vel"), 0)
    assert (told[3].eph, told[3].epv) == (65534, 65534)
    assert max(told[4].eph, told[4].epv) < 2000


def test_heights_are_above_mean_sea_level_and_samples_come_at_250_hz(path):
    """The geoid of Innsbruck is 47 m above the ellipsoid: heights are lower by that."""
    changes = {"rate_hz": 250, "duration_s": 1.2, "sensors.mag": None}
    server = Server(path, changes, mavlink=ActuatorChannels(), undulation=47.0, truth=True)
    autopilot = Autopilot(server.port)
    served = server.join()
    autopilot.join(5.0)
    told, truth, data = autopilot.told, served.result.truth, served.result.sensed.data
    assert_allclose(times(told["HIL_SENSOR"], "HIL_SENSOR"), np.arange(1, 301) / 250.0, atol=1e-6)
    rates = columns(told["HIL_SENSOR"], "xgyro", "ygyro", "zgyro")
    assert_allclose(rates[:300], data.imu.dtheta_b[:300] * 250.0, rtol=1e-6, atol=1e-7)
    assert_allclose(columns(told["HIL_GPS"], "alt")[:, 0] * 1e-3, data.fixes.lla[:, 2] - 47.0, atol=0.6e-3)
    state = columns(told["HIL_STATE_QUATERNION"], "time_usec", "alt") * [1e-6, 1e-3]
    rows = np.searchsorted(truth.t, state[:, 0] - 1e-6)
    assert_allclose(state[:, 1], truth.lla[rows, 2] - 47.0, atol=0.6e-3)


class Rebooting(Autopilot):
    """Closes in the middle of its boot."""

    def steer(self, t, dt, sensed):
        if t > 0.3:
            self._line.shutdown(socket.SHUT_RDWR)


def test_an_autopilot_that_reboots_before_it_commands_finds_the_flight_again(path):
    server = serve(path, 1.5)
    first = Rebooting(server.port)
    first.join(10.0)
    assert server.listen() == "the client has closed the connection; waiting 20 s for another"
    second = Autopilot(server.port)
    served = server.join()
    second.join(5.0)
    assert (served.ended, served.flown) == ("", 1.5)
    assert second.told["HIL_SENSOR"][0].time_usec > first.told["HIL_SENSOR"][-2].time_usec


def test_one_that_does_not_come_back_ends_the_flight(path):
    server = serve(path, 20.0, patience=0.5)
    Rebooting(server.port).join(10.0)
    assert server.join().ended == "the client has not come back for 0.5 s"


class Dull(Autopilot):
    """Leaves two samples of the lock-step without an answer."""

    def steer(self, t, dt, sensed):
        if round(100.0 * t) not in (100, 101):
            super().steer(t, dt, sensed)


def test_a_sample_without_an_answer_does_not_stop_the_flight(path):
    server = serve(path, 1.5)
    autopilot = Dull(server.port)
    served = server.join()
    autopilot.join(5.0)
    assert (served.ended, served.flown) == ("", 1.5)
    assert server.listen() == "2 of the HIL_SENSOR stayed without an answer"


class Late(Autopilot):
    """Reads nothing for a while, then needs long; ``unread`` is how many bytes wait when it answers."""

    def __init__(self, port):
        self.unread = []
        super().__init__(port)

    def steer(self, t, dt, sensed):
        time.sleep(0.003 if self.unread else 0.3)
        with contextlib.suppress(BlockingIOError):
            self.unread.append(0)
            self.unread[-1] = len(self._line.recv(1 << 16, socket.MSG_PEEK | socket.MSG_DONTWAIT))
        super().steer(t, dt, sensed)


def test_answers_of_the_boot_count_for_no_later_sample(path):
    """In lock-step the next HIL_SENSOR is sent after the answer to the one before."""
    server = serve(path, 2.0)
    autopilot = Late(server.port)
    assert server.join().ended == ""
    autopilot.join(5.0)
    assert max(autopilot.unread[:50]) > 0
    assert max(autopilot.unread[100:]) == 0


def test_until_it_commands_the_aircraft_holds_and_time_is_real(path):
    """Disarmed controls, all 0, move nothing. The truth is sent where it is asked for, at each turn."""
    server = serve(path, 2.0, truth=True)
    autopilot = Autopilot(server.port, armed_at=9.0)
    served = server.join()
    autopilot.join(5.0)
    truth, told = served.result.truth, autopilot.told["HIL_STATE_QUATERNION"]
    assert_allclose(truth.lla[-1, 2], truth.lla[0, 2], atol=0.5)
    assert len(told) == 40
    rows = np.arange(5, 201, 5)
    assert_array_equal(columns(told, "time_usec")[:, 0], np.rint(1e6 * truth.t[rows]))
    assert_allclose([one.attitude_quaternion for one in told], truth.q_nb[rows], atol=1e-6)
    assert_allclose(columns(told, "lat", "lon")[:, :2] * 1e-7, np.degrees(truth.lla[rows, :2]), atol=0.6e-7)
    assert_allclose(columns(told, "alt")[:, 0] * 1e-3, truth.lla[rows, 2], atol=0.6e-3)
    assert_allclose(columns(told, "vx", "vy", "vz") / 100.0, truth.vel_n[rows], atol=0.006)
    speed = np.gradient(truth.vel_n, truth.t, axis=0)[rows]  # level and straight: no turn of the axes
    motion = rotation.rotate(rotation.conjugate(truth.q_nb[rows]), speed)
    assert_allclose(columns(told, "xacc", "yacc", "zacc") * 9.80665e-3, motion, atol=0.03)


@pytest.mark.parametrize(
    ("controls", "words"),
    [
        ([math.nan] * 16, "sent HIL_ACTUATOR_CONTROLS with NaN in it in a channel of --channels"),
        ([0.0] * 4 + [1.5] + [0.0] * 11, "with a throttle that is not 0 to 1 in a channel of --channels"),
        (b"GET / HTTP/1.1\r\n\r\n", "sent an invalid MAVLink message: invalid MAVLink prefix '71'"),
        (b"", "has sent no HIL_ACTUATOR_CONTROLS for 0.5 s"),
    ],
)
def test_what_an_autopilot_does_wrong_ends_the_flight_with_a_line(controls, words, path):
    class Wrong(Autopilot):
        def steer(self, t, dt, sensed):
            if controls and t < 1.0:
                super().steer(t, dt, sensed)
            elif isinstance(controls, list):
                self._controls = controls
                super().steer(t, dt, sensed)
            elif controls:
                self._line.sendall(controls)

    server = serve(path, 20.0, patience=0.5)
    autopilot = Wrong(server.port)
    served = server.join()
    autopilot.join(5.0)
    assert served.ended.endswith(words)
    assert served.flown < 1.5


def flood(line, message):
    block = message.pack(dialect.MAVLink(None)) * 1000
    with contextlib.suppress(OSError):
        while True:
            line.sendall(block)


class Stubborn(Autopilot):
    """Commands until a time, then is silent or sends HEARTBEATs alone, as many as it can."""

    def __init__(self, port, until, *, beats):
        self._until, self._beats = until, beats
        super().__init__(port)

    def steer(self, t, dt, sensed):
        if t < self._until:
            super().steer(t, dt, sensed)
        elif self._beats:
            flood(self._line, dialect.MAVLink_heartbeat_message(0, 12, 0, 0, 0, 3))


@pytest.mark.parametrize(
    ("until", "beats", "words"),
    [
        (0.0, True, "the client has sent no HIL_ACTUATOR_CONTROLS for 2 s"),
        (1.0, True, "the client has not answered a HIL_SENSOR for 2 s"),
        (1.0, False, "the client has not answered a HIL_SENSOR for 2 s"),
    ],
)
def test_who_floods_or_is_silent_holds_the_flight_for_no_longer_than_the_patience(until, beats, words, path):
    server = serve(path, 20.0, patience=2.0)
    begun = time.monotonic()
    autopilot = Stubborn(server.port, until, beats=beats)
    served = server.join()
    autopilot.join(5.0)
    assert served.ended.endswith(words)
    assert 0.1 < served.flown < 2.5
    assert time.monotonic() - begun < 20.0


def test_who_floods_without_a_heartbeat_is_sent_away(path):
    server = serve(path, 1.5, patience=0.5)
    with socket.create_connection(("127.0.0.1", server.port)) as line:
        text = dialect.MAVLink_statustext_message(6, b"y")
        threading.Thread(target=flood, args=(line, text), daemon=True).start()
        assert server.listen() == "the client has sent no HEARTBEAT for 0.5 s; waiting for another"
    Autopilot(server.port)
    assert server.join().ended == ""


def test_the_patience_of_the_boot_does_not_count_the_loading_of_the_flight(path, monkeypatch):
    fly = serving.autopilot_flight.fly

    def load_slowly(*args):
        time.sleep(0.7)
        return fly(*args)

    monkeypatch.setattr(serving.autopilot_flight, "fly", load_slowly)
    server = serve(path, 1.5, patience=0.5)
    Autopilot(server.port)
    assert server.join().ended == ""


@pytest.mark.parametrize(
    ("text", "found"),
    [
        ("", ActuatorChannels(-6, -8, -3, 5)),
        ("aileron=1,elevator=-2,throttle=16", ActuatorChannels(1, -2, -3, 16)),
        ("flaps=3", "'flaps' must be one of aileron, elevator, rudder, throttle"),
        ("aileron=1,aileron=2", "aileron is given twice"),
        ("aileron=" + 5000 * "9", "aileron='9{20}' must be a channel, 1 to 16 or -1 to -16"),
        ("aileron=0", "1 to 16 or -1 to -16"),
        ("aileron=17", "1 to 16 or -1 to -16"),
        ("aileron", "1 to 16 or -1 to -16"),
    ],
)
def test_channels_are_read_from_a_list(text, found):
    if isinstance(found, str):
        with pytest.raises(ConfigError, match=found):
            ActuatorChannels.parse(text)
    else:
        assert ActuatorChannels.parse(text) == found
        command = found.take([0.01 * k for k in range(1, 17)])
        signed = [0.01 * one for one in (found.aileron, found.elevator, found.rudder, found.throttle)]
        assert_allclose([command.aileron, command.elevator, command.rudder, command.throttle], signed)
