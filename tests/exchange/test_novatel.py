"""ASCII logs of NovAtel: the examples of its documentation, and a drive that is written as counts."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.testing import assert_allclose

from bench.cli.command_line import main
from bench.core.mathematics.rotation import from_euler, to_euler
from bench.core.words.exceptions import ConfigError
from bench.io.config.log import load_log
from bench.io.log_formats import guess_format
from bench.io.logs import formats
from bench.io.logs.log_records import read_records
from bench.io.logs.reference import read_reference
from tests.damage import spoil
from tests.workbench.test_exporters import drive

WEEK, BEGIN = 2209, 400_000.0
EXAMPLES = """\
%RAWIMUSXA,2209,491674.014;04,41,2209,491674.013699,ea59fe00,329308016,-2706935,4508389,196192,417138,-1000837*038422a7
%RAWIMUSXA,2209,491674.022;04,41,2209,491674.021699,ea59fe00,329308016,-2706935,4508389,196192,417138,-1000837*00000000
%INSPVASA,2209,490712.000;2209,490712.000000000,51.15043713712,-114.03067872932,1080.3580,0.0014,-0.0007,0.0015,-0.293782412,0.302470613,157.989827209,INS_SOLUTION_GOOD*a87ab88b
#INSPVAXA,USB1,0,65.5,FINESTEERING,2209,490782.000,02000020,46eb,16809;INS_SOLUTION_GOOD,INS_PPP,51.15043710672,-114.03067871892,1097.3598,-17.0001,-0.0016,0.0002,0.0029,-0.308665944,0.297893298,157.960833016,0.1816,0.1816,0.1808,0.0018,0.0018,0.0016,0.0292,0.0292,0.0582,13000045,0*a74644a2
#BESTGNSSPOSA,USB1,0,65.0,FINESTEERING,2209,487877.000,02000020,c292,16809;SOL_COMPUTED,PPP,51.15043712234,-114.03067870773,1097.3556,-17.0001,WGS84,0.0176,0.0123,0.0317,"TSTR",17.000,0.000,42,38,38,37,00,00,3f,37*5fea7d4b
"""
"""From RAWIMUSX, INSPVAS, INSPVAX and BESTGNSSPOS of docs.novatel.com/OEM7; the second row is ours."""


def crc32(text: str) -> str:
    """The checksum of the manual, bit by bit."""
    crc = 0
    for byte in text.encode():
        crc ^= byte
        for _ in range(8):
            crc = (crc >> 1) ^ (0xEDB88320 if crc & 1 else 0)
    return f"{crc:08x}"


def close(line: str) -> str:
    return f"{line}*{crc32(line[1:])}"


def test_the_examples_of_the_documentation(tmp_path):
    path = tmp_path / "span.asc"
    path.write_text(EXAMPLES)
    assert guess_format(path) == "novatel"
    imu = formats.read("novatel", path, "imu", None)
    assert_allclose(imu.t, 2209 * 604_800.0 + np.array([491674.013699, 491674.021699]))
    force = imu.values["dvel"][0] * 125.0  # an Epson G320N, forward, right, down: y, x, -z
    mg = 0.2 / 65536 * 9.80665e-3
    assert_allclose(force, [2706935 * mg, 4508389 * mg, -329308016 * mg])
    assert_allclose(force[2], -9.855, atol=1e-3)
    rate = np.rad2deg(imu.values["dtheta"][0]) * 125.0
    assert_allclose(rate, np.array([-417138, -1000837, -196192]) * 0.008 / 65536)
    fix = formats.read("novatel", path, "gnss", None)
    assert_allclose(np.rad2deg(fix.values["lla"][0, :2]), [51.15043712234, -114.03067870773])
    assert_allclose(fix.values["lla"][0, 2], 1097.3556 - 17.0001)
    assert_allclose(fix.values["sd_pos"][0], [0.0176, 0.0123, 0.0317])
    assert fix.values["satellites"][0] == 38
    for topic, t, height, angles in (
        ("INSPVAX", 490782.0, 1097.3598 - 17.0001, [-0.308665944, 0.297893298, 157.960833016]),
        ("INSPVAS", 490712.0, 1080.3580, [-0.293782412, 0.302470613, 157.989827209]),
    ):
        found = formats.read("novatel", path, "gnss", topic)
        assert_allclose(found.t, 2209 * 604_800.0 + t)
        assert_allclose(found.values["lla"][0, 2], height)
        assert_allclose(np.rad2deg(to_euler(found.values["q_nb"][0])), angles)
    assert_allclose(
        formats.read("novatel", path, "gnss", "INSPVAX").values["vel_n"][0], [-0.0016, 0.0002, -0.0029]
    )


def write(path, raw="RAWIMUS", types="58"):
    """Write the drive as an HG4930 counts it, with fixes, velocities and the solution 0.5 m above them."""
    imu, gnss = drive()
    dt, lines = np.diff(imu["t"], prepend=0.0), []
    for t, step, gyro, accel in zip(imu["t"], dt, imu["gyro"], imu["accel"], strict=True):
        (gx, gy, gz), (x, y, z) = gyro * step * 2.0**33, accel * step * 2.0**29
        counts = ",".join(f"{round(v)}" for v in (-z, -x, y, -gz, -gx, gy))  # z, -y, x of x right, y forward
        more = f"00,{types}," if raw.endswith("X") else ""
        when = f"{WEEK},{BEGIN + t:.6f}"
        lines.append((t, close(f"%{raw}A,{WEEK},{BEGIN + t:.3f};{more}{when},00000077,{counts}")))
    for t, lla, (n, e, d) in zip(gnss["t"], gnss["lla"], gnss["vel_n"], strict=True):
        head = f"COM1,0,70.0,FINESTEERING,{WEEK},{BEGIN + t:.3f},02000000,b1f6,16248"
        place = f"{np.rad2deg(lla[0]):.11f},{np.rad2deg(lla[1]):.11f},{lla[2] - 48.5:.4f}"
        speed = f"{np.hypot(n, e):.6f},{np.rad2deg(np.arctan2(e, n)) % 360:.6f},{-d:.6f}"
        tail = 'WGS84,1.5,1.6,2.5,"",0.0,0.0,14,12,12,12,00,06,00,03'
        lines.append((t, close(f"#BESTPOSA,{head};SOL_COMPUTED,SINGLE,{place},48.5,{tail}")))
        lines.append((t, close(f"#BESTVELA,{head};SOL_COMPUTED,DOPPLER_VELOCITY,0.000,0.000,{speed},0.0")))
        up = f"{np.rad2deg(lla[0]):.11f},{np.rad2deg(lla[1]):.11f},{lla[2] - 48.0:.4f}"
        end = "1.0,2.0,30.0,0.1,0.1,0.2,0.01,0.01,0.01,0.1,0.1,0.1,00000000,0"
        status = f"INS_SOLUTION_GOOD,INS_PSRSP,{up},48.5,{n:.4f},{e:.4f},{-d:.4f},{end}"
        lines.append((t, close(f"#INSPVAXA,{head};{status}")))
    lines.sort(key=lambda line: line[0])
    path.write_text("\n".join(line for _, line in lines) + "\n")
    return imu, gnss


@pytest.mark.parametrize(("raw", "topic"), [("RAWIMUS", ""), ("RAWIMUS", "HG4930"), ("RAWIMUSX", "")])
def test_a_drive_comes_back(tmp_path, raw, topic, capsys):
    path = tmp_path / "span.asc"
    imu, gnss = write(path, raw)
    assert main(["new", "log", str(path)]) == 0, capsys.readouterr().err
    log = path.with_suffix(".toml")
    text = log.read_text()
    assert ("its IMU is taken as HG4930 by gravity" in text) == (raw == "RAWIMUS")
    asked = f'format = "novatel"\ntopic = "{topic}"' if topic else 'format = "novatel"'
    reference = '\n[reference]\nfile = "span.asc"\nformat = "novatel"\ntopic = "INSPVAX"\n[sensors.assumed]'
    text = text.replace('format = "novatel"', asked, 1).replace("\n[sensors.assumed]", reference)
    log.write_text(text)
    spec = load_log(str(log))
    found = read_records(spec)
    assert_allclose(found.imu.t, imu["t"] - imu["t"][0], atol=2e-6)
    dt = np.diff(imu["t"], prepend=0.0)[1:, None]
    assert_allclose(found.imu.dtheta_b[1:], imu["gyro"][1:] * dt, atol=1e-9)
    assert_allclose(found.imu.dvel_b[1:], imu["accel"][1:] * dt, atol=2e-9)
    assert_allclose(found.fixes.t, gnss["t"] - imu["t"][0], atol=1e-6)
    assert_allclose(found.fixes.lla[:, 2], gnss["lla"][:, 2], atol=1e-4)
    assert_allclose(found.fixes.vel_n, gnss["vel_n"], atol=1e-5)
    assert spec.reference is not None
    last, arm = float(found.imu.t[-1]), np.asarray(spec.antenna_b)
    track = read_reference(spec.reference, found.origin, last, found.fixes, arm)[0].track
    assert_allclose(track.lla[:, 2], gnss["lla"][: len(track), 2] + 0.5, atol=2e-4)
    assert_allclose(track.q_nb, np.tile(from_euler(*np.deg2rad([1.0, 2.0, 30.0])), (len(track), 1)))


def test_an_unknown_imu_is_asked_for(tmp_path):
    path = tmp_path / "span.asc"
    write(path)
    with pytest.raises(ConfigError, match=r"topic of \[imu\] must be HG1700-AG58, .*it is 'ADIS'"):
        formats.read("novatel", path, "imu", "ADIS")
    lines = [line for line in path.read_text().splitlines() if line.startswith("%")]
    path.write_text("\n".join(lines))
    with pytest.raises(ConfigError, match="no logs BESTGNSSPOS or BESTPOS; topic = 'INSPVAX' reads"):
        formats.read("novatel", path, "gnss", None)
    still = [f"{line.partition('00000077,')[0]}00000077,0,0,9,0,0,0*00000000" for line in lines]
    path.write_text("\n".join(still))
    with pytest.raises(
        ConfigError, match=r"RAWIMUS does not name its IMU; set topic of \[imu\] to one of HG17"
    ):
        formats.read("novatel", path, "imu", None)


def test_damage_is_left_out_and_counted(tmp_path):
    """A changed bit makes the checksum wrong; no value of a damaged log is used."""
    path = tmp_path / "span.asc"
    write(path)
    whole = path.read_bytes()[:40_000]
    sound = {kind: formats.read("novatel", path, kind, None) for kind in ("imu", "gnss")}
    lines = []
    for raw in spoil(whole, 7, bits=1):
        path.write_bytes(raw)
        for kind, name in (("imu", "dvel"), ("gnss", "lla")):
            try:
                rows = formats.read("novatel", path, kind, "HG4930" if kind == "imu" else None)
            except ConfigError as error:
                lines.append(str(error))
            else:
                at = np.searchsorted(sound[kind].t, rows.t - 1e-4)
                assert_allclose(rows.values[name], sound[kind].values[name][at], rtol=1e-9)
    assert not [line for line in lines if "\n" in line or not line.startswith("span.asc: ")]
