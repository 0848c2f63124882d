"""Every message of a stream is decoded here by the documented layout, not by the code that wrote it, and is
the row of the run; pace, addresses and the end are as they are told."""

from __future__ import annotations

import os
import re
import signal
import socket
import struct
import subprocess
import sys
import threading
import time
from contextlib import contextmanager

import numpy as np
import pyarrow.parquet as pq
import pytest
from numpy.testing import assert_array_equal

from bench.cli.command_line import main
from tests.exchange.exported import make_run
from tests.exchange.test_export import sentence


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    folder = tmp_path_factory.mktemp("runs") / "circle"
    make_run(folder)
    return folder


def crc16(data: bytes) -> int:
    """CRC-16/CCITT-FALSE bit by bit: polynomial 0x1021, start 0xFFFF."""
    crc = 0xFFFF
    for byte in data:
        crc ^= byte << 8
        for _ in range(8):
            crc = ((crc << 1) ^ 0x1021 if crc & 0x8000 else crc << 1) & 0xFFFF
    return crc


def decoded(data: bytes) -> tuple[dict[int, list[tuple]], list[str], list[int], int]:
    """Payloads by kind, sentences, frame numbers, and the bytes left over at the end."""
    frames: dict[int, list[tuple]] = {}
    sentences, numbers, at = [], [], 0
    while at < len(data):
        if data[at : at + 1] == b"$":
            end = data.find(b"\r\n", at)
            if end < 0:
                break
            sentences.append(data[at:end].decode("ascii"))
            at = end + 2
            continue
        assert data[at : at + 2] == b"\xaa\x55"
        kind, n, number = struct.unpack_from("<BBI", data, at + 2)
        end = at + 8 + n + 2
        if end > len(data):
            break
        assert struct.unpack_from("<H", data, end - 2)[0] == crc16(data[at + 2 : end - 2])
        frames.setdefault(kind, []).append(struct.unpack(f"<{n // 8}dB", data[at + 8 : end - 2]))
        numbers.append(number)
        at = end
    return frames, sentences, numbers, len(data) - at


def compare(run, data: bytes) -> None:
    frames, sentences, numbers, left = decoded(data)
    assert left == 0
    assert numbers == list(range(len(numbers)))
    imu = pq.read_table(run / "sensors-imu.parquet")
    names = ["t_s", "dt_s", *(f"dtheta_{a}_rad" for a in "xyz"), *(f"dvel_{a}_mps" for a in "xyz"), "valid"]
    assert_array_equal(np.array(frames[1]), np.column_stack([imu[name].to_numpy() for name in names]))
    baro = pq.read_table(run / "sensors-baro.parquet")
    names = ["t_s", "alt_baro_m", "sd_m", "valid"]
    assert_array_equal(np.array(frames[2]), np.column_stack([baro[name].to_numpy() for name in names]))
    assert set(frames) == {1, 2}
    gnss = pq.read_table(run / "sensors-gnss.parquet")
    assert len(sentences) == 2 * gnss.num_rows
    for k in range(gnss.num_rows):
        place, motion = sentence(sentences[2 * k], "GPGGA", 15), sentence(sentences[2 * k + 1], "GPRMC", 13)
        assert motion[2] == ("A" if gnss["valid"][k].as_py() else "V")
        if motion[2] == "A":
            minutes = np.rad2deg(gnss["lat_rad"][k].as_py()) * 60
            assert int(place[2][:2]) * 60 + float(place[2][2:]) == pytest.approx(minutes, abs=1e-7)


@contextmanager
def streaming(run, *options: str):
    command = [sys.executable, "-m", "bench", "stream", str(run), *options]
    pipes = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE, "text": True}
    with subprocess.Popen(command, **pipes) as process:
        try:
            yield process
        finally:
            process.kill()


def port_of(process: subprocess.Popen) -> int:
    line = process.stdout.readline()
    return int(re.search(r":(\d+);", line)[1])


def received(connection: socket.socket) -> bytes:
    parts = []
    while part := connection.recv(1 << 16):
        parts.append(part)
    return b"".join(parts)


def test_tcp_carries_every_row_of_the_run_bit_for_bit(run):
    with streaming(run, "--tcp", "127.0.0.1:0", "--rate", "0") as process:
        with socket.create_connection(("127.0.0.1", port_of(process)), 20) as connection:
            compare(run, received(connection))
        assert process.wait(20) == 0
        # 2000 IMU, 200 baro frames, 18 fixes of two sentences
        assert process.stdout.read().startswith("2236 messages in ")


def test_udp_is_a_datagram_per_message(run, capsys):
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as inbox:
        inbox.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 1 << 22)
        inbox.bind(("127.0.0.1", 0))
        inbox.settimeout(5.0)
        parts: list[bytes] = []

        def listen() -> None:
            while len(parts) < 2236:
                parts.append(inbox.recv(1 << 16))

        ear = threading.Thread(target=listen, daemon=True)
        ear.start()
        address = f"127.0.0.1:{inbox.getsockname()[1]}"
        assert main(["stream", str(run), "--udp", address, "--rate", "20"]) == 0
        ear.join(10)
    assert capsys.readouterr().out.startswith(f"sending to {address}, a datagram per message")
    assert len(parts) == 2236
    for part in parts:
        frames, sentences, _, left = decoded(part)
        assert (len(sentences) + sum(map(len, frames.values())), left) == (1, 0)
    compare(run, b"".join(parts))


def test_messages_come_when_they_would_arrive_and_not_before(run):
    with streaming(run, "--tcp", "127.0.0.1:0", "--rate", "10") as process:
        with socket.create_connection(("127.0.0.1", port_of(process)), 20) as connection:
            begun, data, seen = time.monotonic(), b"", []
            while part := connection.recv(1 << 16):
                data += part
                seen.append((time.monotonic() - begun, len(data)))
        assert process.wait(20) == 0
        assert "ms late" in process.stdout.read()
    frames, *_ = decoded(data)
    took = seen[-1][0]
    assert took > 1.99 - 0.1  # 19.99 s of the run at ten times its pace; a busy machine may take longer
    half = next(size for t, size in seen if t > took / 2)
    assert abs(half / len(data) - 0.5) < 0.25
    assert frames[1][-1][0] == 20.0


def test_the_order_is_that_of_arrival(run):
    from dataclasses import replace

    from bench.io.exports import gather
    from bench.io.streams.frames import make_messages

    whole = gather(run)
    fixes = replace(whole.fixes, t_arrival=whole.fixes.t + 0.155)
    arrivals = list(make_messages(replace(whole, fixes=fixes)))
    times = [t for t, _ in arrivals]
    assert times == sorted(times)
    where = next(k for k, (_, message) in enumerate(arrivals) if message.startswith(b"$"))
    before, *_ = decoded(arrivals[where - 1][1])
    assert next(iter(before.values()))[0][0] == 1.15  # the last row of the IMU before 1.155 s
    assert b"000001.000" in arrivals[where][1]


def test_ctrl_c_ends_it(run):
    for connect in (False, True):
        with streaming(run, "--tcp", "127.0.0.1:0", "--rate", "0.1") as process:
            port = port_of(process)
            with socket.socket() as connection:
                if connect:
                    connection.connect(("127.0.0.1", port))
                    connection.recv(100)
                os.kill(process.pid, signal.SIGINT)
                assert process.wait(20) == 130
            assert process.stderr.read().strip() == "error: interrupted"


def test_a_client_that_leaves_is_said_in_one_line(run):
    with streaming(run, "--tcp", "127.0.0.1:0", "--rate", "1") as process:
        with socket.create_connection(("127.0.0.1", port_of(process)), 20) as connection:
            connection.recv(100)
        assert process.wait(20) == 4
        err = process.stderr.read()
        assert re.fullmatch(
            r"error: tcp 127\.0\.0\.1:0: the other side closed the connection after \d+ messages\n", err
        )


@pytest.mark.parametrize(
    ("options", "said"),
    [
        ((), "give one of --udp IP:PORT and --tcp IP:PORT"),
        (("--udp", "127.0.0.1:1", "--tcp", "127.0.0.1:2"), "give one of --udp"),
        (("--udp", "127.0.0.1"), "--udp 127.0.0.1: must be IP:PORT, for example 127.0.0.1:5600"),
        (("--udp", "127.0.0.1:0"), "must be IP:PORT"),
        (("--udp", "127.0.0.1:99999"), "must be IP:PORT"),
        (("--udp", "example.org:5600"), "'example.org' is not an IP address"),
        (
            ("--udp", "192.0.2.1:5600"),
            "the address is not on this machine; --allow-remote permits sending to it",
        ),
        (("--tcp", "0.0.0.0:5600"), "not on this machine"),
        (("--tcp", "[::]:5600"), "not on this machine"),
        (("--udp", "127.0.0.1:5600", "--rate", "-1"), "--rate -1 must not be negative"),
        (("--udp", "127.0.0.1:5600", "--rate", "nan"), "--rate nan must not be negative"),
    ],
)
def test_a_wrong_command_line_is_one_line(run, capsys, options, said):
    assert main(["stream", str(run), *options]) == 2
    out, err = capsys.readouterr()
    assert (out, err.count("\n")) == ("", 1)
    assert said in err


def test_a_port_that_is_taken(run, capsys):
    with socket.socket() as other:
        other.bind(("127.0.0.1", 0))
        other.listen(1)
        port = other.getsockname()[1]
        assert main(["stream", str(run), "--tcp", f"127.0.0.1:{port}"]) == 4
    assert capsys.readouterr().err == f"error: tcp 127.0.0.1:{port}: Address already in use\n"


def test_an_address_that_cannot_be_reached_is_named(run, capsys):
    to = ("--udp", "255.255.255.255:5600", "--allow-remote", "--rate", "0")
    assert main(["stream", str(run), *to]) == 4
    err = capsys.readouterr().err
    assert err.startswith("error: udp 255.255.255.255:5600: ")
    assert err.count("\n") == 1


def test_no_run_no_stream(tmp_path, capsys):
    assert main(["stream", str(tmp_path), "--udp", "127.0.0.1:5600"]) == 2
    assert "not a results folder" in capsys.readouterr().err
