"""A client flies: in C by the documented layout, in Python by ours, and some that do what they must not."""

from __future__ import annotations

import contextlib
import json
import math
import re
import shlex
import shutil
import socket
import struct
import subprocess
import threading
import time
from pathlib import Path
from queue import Queue

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

import bench
from bench.cli.command_line import commands, main
from bench.core.mathematics import rotation
from bench.core.records.instruments import INSTRUMENTS
from bench.core.words.exceptions import ConfigError, EstimatorStoppedError
from bench.io import config
from bench.io.streams.frames import make_frames
from bench.pipeline import closed_loop
from bench.plugins.hil import flight_client, serving
from bench.plugins.hil.actuator_channels import ActuatorChannels
from bench.plugins.hil.client_session import ClientSession
from bench.plugins.hil.flight_client import FlightClient
from bench.plugins.hil.mavlink_session import MavlinkSession
from tests.exchange.test_stream import crc16, decoded
from tests.test_closed_loop import PROFILE

COMPILER = shutil.which("cc")
CLIENT = Path(flight_client.__file__).with_suffix(".c")
SHORT = {"guidance.navigation": "client", "evaluation.from_s": 1.0, "guidance.period_s": 0.5}


@pytest.fixture(scope="module")
def path(tmp_path_factory):
    path = tmp_path_factory.mktemp("served") / "closed.toml"
    path.write_text(PROFILE)
    return path


def write_straight(path, seconds):
    begin, end = PROFILE.index('[[leg]]\nkind = "turn"'), PROFILE.index("[sensors]")
    path.write_text(PROFILE[:begin].replace("duration_s = 10.0", f"duration_s = {seconds}") + PROFILE[end:])
    return path


class Server:
    """A flight that waits for a client in a thread; ``join`` gives what it was, or raises."""

    def __init__(self, path, changes=None, **options):
        given = {"duration_s": 40.0, **SHORT, **(changes or {})}
        self._profile = config.read_profile(path, given)
        self._options, self._said = {"address": "127.0.0.1:0", "patience": 20.0, **options}, Queue()
        self._found = None
        self._thread = threading.Thread(target=self._fly, daemon=True)
        self._thread.start()
        line = self._said.get(timeout=60)
        assert line.startswith("waiting for a connection on 127.0.0.1:"), line
        self.port = int(line.split(":")[1].split(";")[0])

    def _fly(self):
        try:
            self._found = serving.serve(
                self._profile, progress=lambda now: self._said.put(str(now)), **self._options
            )
        except Exception as error:
            self._found = error
            self._said.put(str(error))

    def listen(self):
        """Return the next line but those of a client that comes."""
        while (line := self._said.get(timeout=60)).startswith("a client has come"):
            pass
        return line

    def join(self):
        self._thread.join(timeout=120)
        if isinstance(self._found, Exception):
            raise self._found
        return self._found


def frame(kind, *values, last=1):
    body = struct.pack(f"<{len(values)}dB", *values, last)
    checked = struct.pack("<BBI", kind, len(body), 0) + body
    return b"\xaa\x55" + checked + struct.pack("<H", crc16(checked))


def read_to_end(line):
    """Return what comes until the server closes; it waits two seconds for who does not close then."""
    return b"".join(iter(lambda: line.recv(1 << 16), b""))


@pytest.mark.skipif(COMPILER is None, reason="no C compiler here")
@pytest.mark.parametrize("gives", ["estimate", "commands"])
def test_a_client_in_c_flies(gives, path, tmp_path):
    program = tmp_path / "flight_client"
    flags = ["-std=c99", "-Wall", "-Wextra", "-Werror", "-pedantic", "-O2"]
    subprocess.run([COMPILER, *flags, "-o", program, CLIENT, "-lm"], check=True)
    server = Server(path, {"guidance.period_s": 0.2}, gives=gives)
    done = subprocess.run([program, str(server.port), gives], capture_output=True, text=True, timeout=120)
    assert (done.returncode, done.stdout, done.stderr) == (0, "the flight is over\n", "")
    served = server.join()
    truth, answers = served.result.truth, served.result.solutions["in-flight"]
    assert (served.ended, served.flown, len(answers)) == ("", 40.0, 200)
    rows = np.searchsorted(truth.t, answers.t - 1e-9)
    assert_allclose(answers.lla[:, :2], truth.lla[rows, :2], atol=10.0 / 6.4e6)  # 10 m
    assert_allclose(answers.vel_n, truth.vel_n[rows], atol=1.0)
    assert served.result.provenance["served"]["gives"] == gives
    heading = [rotation.to_euler(q_nb)[2] for q_nb in truth.q_nb[[0, -1]]]
    (text,) = [row[2] for row in truth.events.select("leg")][-1:]
    if gives == "commands":
        bank = rotation.to_euler(truth.q_nb[-1])[0]
        assert_allclose(bank, 0.2, atol=0.02)  # the target of the client
        assert_allclose(truth.lla[-1, 2], truth.lla[0, 2], atol=15.0)
        assert "commands: of a client" in text
    else:
        assert_allclose(heading[1] - heading[0], math.pi / 2, atol=0.1)  # the legs of the profile


WORDS = b"the flight is over\x01"


def test_a_client_gets_the_rows_that_are_recorded(tmp_path):
    """Decoded by the layout as the guide has it; what is late comes after the turn before its arrival."""
    path = write_straight(tmp_path / "straight.toml", 6.0)
    server, data = Server(path, {"duration_s": 6.0}, rate=4.0), b""
    begun = time.monotonic()
    with socket.create_connection(("127.0.0.1", server.port)) as line:
        line.sendall(frame(16, 1.0))
        turns = 0
        while True:
            data += line.recv(1 << 16)
            if data[:-2].endswith(WORDS):
                break
            frames, _, numbers, left = decoded(data)
            if left == 0 and len(frames.get(18, [])) > turns:
                turns = len(frames[18])
                line.sendall(frame(22, frames[18][-1][0]))
    assert time.monotonic() - begun > (6.0 - 0.5) / 4.0  # from the first turn on
    served = server.join()
    sensors = served.result.sensed.data
    assert numbers == list(range(len(numbers)))
    assert left == 0
    imu = sensors.imu
    columns = [imu.t, imu.dt, *imu.dtheta_b.T, *imu.dvel_b.T, imu.valid]
    assert_array_equal(np.array(frames[1]), np.column_stack(columns))
    baro, values = sensors.baro, INSTRUMENTS["baro"].values(sensors.baro)
    come = baro.t_arrival <= 6.0 + 1e-9
    assert_array_equal(np.array(frames[2]), np.column_stack([baro.t, values, baro.sd, baro.valid])[come])
    fixes = sensors.fixes.take(sensors.fixes.t_arrival <= 6.0 + 1e-9)
    upper = np.triu_indices(3)
    covs = [cov[:, upper[0], upper[1]] for cov in (fixes.cov_pos_n, fixes.cov_vel_n)]
    columns = [
        fixes.t[:, None],
        fixes.lla,
        fixes.vel_n,
        *covs,
        fixes.satellites[:, None],
        fixes.valid[:, None],
    ]
    assert_array_equal(np.array(frames[8]), np.hstack(columns))
    assert len(frames[8]) > 10
    assert "in-flight" not in served.result.solutions  # it gave no estimate
    assert served.result.provenance["served"]["ended"] == ""
    arrivals = {1: imu.t, 2: baro.t_arrival, 3: sensors.mag.t_arrival, 8: sensors.fixes.t_arrival}
    rows = {1: imu.t, 2: baro.t, 3: sensors.mag.t, 8: sensors.fixes.t}
    told = [(kind, struct.unpack_from("<d", body)[0]) for kind, body in make_frames(sensors)]
    order = [(arrivals[kind][np.searchsorted(rows[kind], t)], kind) for kind, t in told]
    assert order == sorted(order)  # of one time the IMU first and the fixes last


GOOD = (0.8248, 0.1979, 1206.0, 0.0, 25.0, 0.0, 1.0, 0.0, 0.0, 0.0, *[math.nan] * 15)


BEGINNINGS = [
    (b"GET / HTTP/1.1\r\n\r\n", "sent 47 45 where a message begins with aa 55"),
    (frame(16, 2.0), "speaks version 2 of the messages; this is version 1"),
    (frame(16, math.nan), "speaks version nan of the messages; this is version 1"),
    (frame(16, 1.0, 2.0), "sent HELLO with 17 bytes; 9 are right"),
    (frame(22, 0.5) * 2, "began with DONE; HELLO comes first"),
    (frame(16, 1.0)[:-1] + b"\x00", "sent a message HELLO whose checksum is wrong"),
    (frame(16, 1.0)[:7], "has closed the connection in the middle of a message"),
    (b"", "has been silent for 0.3 s"),
]


def test_who_begins_wrongly_is_told_why_and_the_next_one_flies(tmp_path):
    server = Server(
        write_straight(tmp_path / "straight.toml", 2.0),
        {"duration_s": 2.0, "evaluation.from_s": 0.0},
        patience=0.3,
    )
    for sent, words in BEGINNINGS:
        with socket.create_connection(("127.0.0.1", server.port)) as line:
            line.sendall(sent)
            if words.endswith("message"):
                line.shutdown(socket.SHUT_WR)
            assert f"the client {words}".encode() in line.recv(1000)
        assert server.listen() == f"the client {words}; waiting for another"
    with FlightClient(server.port) as client:
        assert len(list(client.turns())) == 4
    assert (server.join().ended, client.end) == ("", "the flight is over")


@pytest.mark.parametrize(
    ("sent", "words"),
    [
        (frame(19, 0.5, *GOOD[1:5]), "sent ESTIMATE with 41 bytes; 209 are right"),
        (frame(19, 0.5, math.nan, *GOOD[1:]), "sent an ESTIMATE with NaN in position, velocity or attitude"),
        (
            frame(19, 0.5, 47.26, *GOOD[1:]),
            "sent an ESTIMATE that is no latitude, longitude [rad] and height [m]",
        ),
        (frame(19, 0.5, *GOOD[:6], 2.0, *GOOD[7:]), "sent an ESTIMATE whose quaternion has not the length 1"),
        (
            frame(19, 0.5, *GOOD[:3], 1e300, *GOOD[4:]),
            "sent an ESTIMATE with a velocity or bias beyond any aircraft",
        ),
        (
            frame(19, 0.5, *GOOD[:16], -3.0, *GOOD[17:]),
            "sent an ESTIMATE with a standard deviation that is not in 0 to 1e+07; NaN: none",
        ),
        (frame(20, 0.5, 0.0, math.nan, 0.5), "sent ATTITUDE with NaN in it"),
        (frame(21, 0.5, 0.0, 0.0, 1.5, 0.5), "sent SURFACES with a surface that is not -1 to 1"),
        (frame(20, 0.5, 0.0, 0.0, 0.5) * 2, "sent two answers of one kind (ATTITUDE) at 0.5 s"),
        (frame(22, 0.4), "sent DONE for 0.4 s at the turn of 0.5 s"),
        (frame(99, 0.5), "sent kind 99, which is none of HELLO, ESTIMATE, ATTITUDE, SURFACES, DONE"),
        (frame(19, 0.5)[:9], "has closed the connection in the middle of a message"),
        (None, "has closed the connection"),
        (b"", "has been silent for 1 s"),
    ],
)
def test_what_a_client_does_wrong_in_flight_ends_it_with_a_line(sent, words, path):
    """The flight until then is a result, and says why it ended; the client is told, too."""
    server = Server(path, gives="commands", patience=1.0)
    with socket.create_connection(("127.0.0.1", server.port)) as line:
        line.sendall(frame(16, 1.0))
        data = b""
        while 18 not in decoded(data)[0]:
            data += line.recv(1 << 16)
        if sent is None:
            line.close()
        else:
            line.sendall(sent)
            if 0 < len(sent) < 10:
                line.shutdown(socket.SHUT_WR)
            assert f"the client {words}".encode() in read_to_end(line)
    served = server.join()
    assert served.ended.endswith(f"the client {words}")
    (crash,) = served.result.truth.events.select("crash")
    assert crash[2].endswith(f"the client {words}")
    assert served.flown < 1.0


def test_a_client_steers_only_where_it_may(path):
    server = Server(path, patience=5.0)
    with socket.create_connection(("127.0.0.1", server.port)) as line:
        line.sendall(frame(16, 1.0))
        data = b""
        while 18 not in decoded(data)[0]:
            data += line.recv(1 << 16)
        line.sendall(frame(20, 0.5, 0.0, 0.0, 0.5))
        read_to_end(line)
    served = server.join()
    assert served.ended == "the client sent ATTITUDE; bench serve --give commands lets a client steer"


def test_an_estimate_whose_turn_was_never_ended_is_no_answer(tmp_path):
    server = Server(write_straight(tmp_path / "straight.toml", 2.0), {"duration_s": 2.0})
    with socket.create_connection(("127.0.0.1", server.port)) as line:
        line.sendall(frame(16, 1.0) + frame(19, 0.5, *GOOD) + frame(22, 0.4))
        read_to_end(line)
    served = server.join()
    assert (served.ended, served.flown) == ("the client sent DONE for 0.4 s at the turn of 0.5 s", 2.0)
    assert "in-flight" not in served.result.solutions


def test_a_client_that_never_stops_sending_does_not_hold_the_server(path):
    """It is rejected, and the end is not waited for longer than two seconds."""
    server, begun = Server(path, patience=1.0), time.monotonic()
    with socket.create_connection(("127.0.0.1", server.port)) as line, contextlib.suppress(OSError):
        while time.monotonic() < begun + 20.0:
            line.sendall(b"y\n" * 100)
            time.sleep(0.1)
    assert server.listen().endswith("waiting for another")
    assert time.monotonic() - begun < 15.0


@pytest.mark.parametrize(
    ("sent", "words"),
    [
        (frame(18, 0.5), "expected HELLO, received TURN. Is this a 'bench serve' server?"),
        (frame(99), "expected HELLO, received kind 99. Is this a 'bench serve' server?"),
        (b"SSH-2.0-", "the server sent 53 53 where a message begins with aa 55"),
    ],
)
def test_a_server_that_is_none_is_said_in_a_line(sent, words):
    with socket.create_server(("127.0.0.1", 0)) as server:

        def answer():
            with server.accept()[0] as line:
                line.sendall(sent)
                line.recv(100)

        threading.Thread(target=answer, daemon=True).start()
        with pytest.raises(ConnectionError) as caught:
            FlightClient(server.getsockname()[1])
    assert str(caught.value) == words


def test_a_second_client_is_told_that_another_flies(tmp_path):
    server = Server(write_straight(tmp_path / "straight.toml", 4.0), {"duration_s": 4.0})
    with FlightClient(server.port) as first:
        turns = first.turns()
        next(turns)
        with pytest.raises(ConnectionError, match="another client flies; one at a time"):
            FlightClient(server.port)
        list(turns)
    assert first.end == "the flight is over"
    assert server.join().ended == ""


def test_a_client_that_leaves_in_the_first_second_is_a_line(path, tmp_path, capsys, monkeypatch):
    """A flight too short for a fix has nothing to evaluate: no traceback, of a client as of a profile."""
    monkeypatch.setattr("bench.plugins.hil.client_session.PATIENCE", 0.1)
    slow = {"sensors.gnss": "l1-code", "guidance.period_s": 0.25}
    server = Server(path, slow, gives="commands")
    with socket.create_connection(("127.0.0.1", server.port)) as line:
        line.sendall(frame(16, 1.0))
        line.recv(1 << 16)
    with pytest.raises(EstimatorStoppedError) as caught:
        server.join()
    assert str(caught.value) == (
        "the client has closed the connection after 0.3 s, nothing can be evaluated: "
        "gnss: no epoch at 1 Hz within 0.3 s of truth; it needs a longer flight or a higher rate"
    )
    tiny = write_straight(tmp_path / "tiny.toml", 0.5)
    tiny.write_text(tiny.read_text().replace('[guidance]\nnavigation = "loose-15"\n', ""))
    given = ["--set", "sensors.gnss=l1-code", "--set", "evaluation.from_s=0.0", "-o", str(tmp_path / "out")]
    assert main(["run", str(tiny), *given]) == 2
    assert "gnss: no epoch at 1 Hz within 0.5 s" in capsys.readouterr().err


def test_a_silent_client_shuts_nobody_out(tmp_path, monkeypatch):
    monkeypatch.setattr("bench.plugins.hil.client_session.ALONE", 0.2)
    server = Server(write_straight(tmp_path / "straight.toml", 2.0), {"duration_s": 2.0}, patience=60.0)
    with socket.create_connection(("127.0.0.1", server.port)) as silent:
        silent.sendall(frame(16, 1.0)[:7])
        begun = time.monotonic()
        with FlightClient(server.port) as second:
            list(second.turns())
        assert time.monotonic() - begun < 30.0
        assert b"has not begun in 0.2 s, and another one waits" in read_to_end(silent)
    assert server.join().ended == ""


def test_a_served_flight_is_recorded_like_a_run(path, tmp_path, capsys):
    """It flies by what the client says, 20 m too high; the folder can be loaded and shown."""
    with socket.create_server(("127.0.0.1", 0)) as free:
        port = free.getsockname()[1]
    thread = threading.Thread(target=_fly_high, args=(port,), daemon=True)
    thread.start()
    out, straight = tmp_path / "out", write_straight(tmp_path / "straight.toml", 45.0)
    main(["serve", str(straight), "--no-rrd", "--no-report", "--port", str(port), "-o", str(out), "--json"])
    thread.join()
    said = capsys.readouterr()
    assert "Flew 45 s with the client" in " ".join(said.err.split())
    found = bench.read_result(out)
    assert json.loads(said.out)["in-flight"]["pos_rmse_h_m"] == found.metrics["in-flight"]["pos_rmse_h_m"]
    truth, answers = found.truth, found.solutions["in-flight"]
    assert found.provenance["served"]["ended"] == ""
    rows = np.searchsorted(truth.t, answers.t - 1e-9)
    above = answers.lla[:, 2] - truth.lla[rows, 2]
    assert ((above > 12.0) & (above < 32.0)).all()
    believed = answers.lla[answers.t > 15.0, 2].mean()  # it flies where it assumes the height asked for to be
    assert_allclose(believed, truth.lla[0, 2], atol=10.0)
    assert main(["show", str(out)]) == 0


def _fly_high(port):
    for _ in range(600):
        try:
            client = FlightClient(port)
            break
        except ConnectionRefusedError:
            time.sleep(0.1)
    with client:
        q_nb, fix = client.start[7:11], client.start[1:7]
        for _, frames in client.turns():
            for one in frames:
                if one.name == "FIX" and one.valid:
                    fix = one.values()[1:7]
            client.estimate((*fix[:2], fix[2] + 20.0), fix[3:6], q_nb)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"address": "0.0.0.0:0"}, "--allow-remote"),
        ({"rate": math.nan}, "must not be negative"),
        ({"patience": 0.0}, "must be above 0"),
        ({"truth": True}, "--truth needs --mavlink"),
        ({"mavlink": ActuatorChannels(), "ardupilot": ActuatorChannels()}, "one autopilot at a time"),
    ],
)
def test_wrong_options_are_refused_before_a_client_comes(options, message, path):
    with pytest.raises(ConfigError, match=message):
        serving.serve(config.read_profile(path, SHORT), **options)


def test_the_commands_of_the_guide_and_the_help_are_right(tmp_path, monkeypatch, capsys):
    """Each is taken until a client would come."""
    page = CLIENT.with_name("serve.md")
    lines = [*page.read_text().splitlines(), *commands.get_command(None, "serve").help.splitlines()]
    found = {line.strip() for line in lines if line.strip().startswith("bench serve ")}
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(serving, "listen", stop)
    for line in sorted(found):
        assert main(shlex.split(line)[1:]) == 2, line
        assert capsys.readouterr().err.strip().endswith("would wait"), line
    assert len(found) >= 4


def stop(*_, **__):
    raise ConfigError("would wait")


def test_a_profile_for_a_client_is_no_run(path):
    with pytest.raises(ConfigError, match="bench serve flies it"):
        bench.run(path, overrides=SHORT)
    with pytest.raises(ConfigError, match="Set the duration: --set duration_s"):
        serving.serve(config.read_profile(path, SHORT), gives="commands")
    with pytest.raises(ConfigError, match=r"needs \[guidance\] navigation = \"client\"; by its name"):
        serving.serve(config.read_profile(path))
    with pytest.raises(ConfigError, match="seed and overrides change nothing"):
        serving.serve(config.read_profile(path, SHORT), seed=1)


def test_legs_that_do_not_fit_their_duration_are_refused_before_a_client_comes(path, capsys):
    assert main(["serve", str(path), "--port", "0", "--set", "duration_s=12"]) == 3
    (line,) = capsys.readouterr().err.splitlines()
    assert re.fullmatch(r"error: the legs need [0-9.]+ s; duration is 12 s", line)


@pytest.mark.parametrize("mavlink", [None, ActuatorChannels()])
def test_from_python_a_profile_is_served_as_by_the_verb(mavlink, monkeypatch):
    """`approach-closed` is flown by a filter at turns of 0.2 s."""
    flown = []

    def fly(profile, *_):
        flown.append(profile)
        raise ConfigError("it would fly")

    monkeypatch.setattr(closed_loop, "serve", fly)
    monkeypatch.setattr(serving.autopilot_flight, "fly", fly)
    monkeypatch.setattr(ClientSession, "wait", lambda self, say: None)
    monkeypatch.setattr(MavlinkSession, "wait", lambda self, say: None)
    options = [] if mavlink is None else ["--mavlink", "--set", "duration_s=120"]
    overrides = None if mavlink is None else {"duration_s": 120.0}
    with pytest.raises(ConfigError, match="it would fly"):
        bench.serve("approach-closed", address="127.0.0.1:0", mavlink=mavlink, seed=3, overrides=overrides)
    changes = ["--seed", "3", "--port", "0"]
    assert main(["serve", "approach-closed", *options, *changes]) == 2
    by_python, by_verb = flown
    assert by_python == by_verb
    assert (by_python.guidance.navigation.use, by_python.seed) == ("client", 3)
