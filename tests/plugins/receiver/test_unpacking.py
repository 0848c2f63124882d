"""Packed files are read block by block: what they unpack to may be large, the memory for it is not.

The memory is that of Python, as tracemalloc sees it; contents of 10 MB and more must not show in it.
"""

import dataclasses
import gzip
import tracemalloc

import numpy as np
import pytest
from scipy.io import savemat

from bench.core.words.exceptions import ConfigError
from bench.io.logs.mat_files import mat_file
from bench.io.trajectories.track_files import read_track
from bench.plugins.receiver.receiver_streams.ubx import read_ubx
from bench.plugins.receiver.rinex import precise_orbits, unpacking
from bench.plugins.receiver.rinex.lines import find_kind
from bench.plugins.receiver.rinex.observations import read_observations
from bench.plugins.receiver.rinex.precise_orbits import read_precise_orbits
from bench.simulation.flight import model_files
from tests.data import stored_gnss_file
from tests.plugins.receiver.packed import compress, write_codes

SYSTEMS = {"C": "C2I L2I D2I S2I", "E": "C1C L1C D1C S1C", "G": "C1C L1C D1C S1C", "R": "C1C L1C D1C S1C"}
F9T = "F9T-L2-2min.ubx.gz"


def peak_memory(read, path):
    """Return what reading a file gives or raises, and the memory that it takes meanwhile [byte]."""
    tracemalloc.start()
    try:
        found = read(path)
    except ConfigError as error:
        found = error
    try:
        return found, tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()


def make_head():
    """Return the lines of a Compact RINEX file before its epochs."""
    lines = [("3.0" + 17 * " " + "COMPACT RINEX FORMAT", "CRINEX VERS   / TYPE"), ("", "CRINEX PROG / DATE")]
    lines += [("     3.04           OBSERVATION DATA    M", "RINEX VERSION / TYPE")]
    lines += [(f"{letter}    4 {names}", "SYS / # / OBS TYPES") for letter, names in SYSTEMS.items()]
    lines += [("", "END OF HEADER")]
    return "".join(f"{body:60}{label}\n" for body, label in lines)


def make_crinex(epochs, each):
    """Return a Compact RINEX file at 1 Hz of four systems, and its values (epochs, satellites, 4) [1/1000].

    One satellite is away for five epochs; its values begin anew.
    """
    names = [f"{letter}{k + 1:02d}" for letter in SYSTEMS for k in range(each)]
    random = np.random.default_rng(1)
    t, s = np.arange(epochs)[:, None, None], np.arange(len(names))[None, :, None]
    smooth = 2.2e7 + 300.0 * (s - 6) * t + 0.02 * t**2 + np.array([0.0, 8e7, -2.2e7, -2.2e7])
    values = np.round(1000 * (smooth + random.normal(size=(epochs, len(names), 4)))).astype(np.int64)
    parts, before, since = [make_head()], "", np.zeros(len(names), int)
    for k in range(epochs):
        here = [n for n in range(len(names)) if not (n == 2 and 20 <= k < 25)]
        head = f"> 2022 06 08 00 {k // 60:02d} {k % 60:02d}.0000000  0{len(here):3d}{6 * ' '}"
        head += "".join(names[n] for n in here)
        width = max(len(head), len(before))
        pairs = zip(before.ljust(width), head.ljust(width), strict=True)
        parts.append("".join(" " if a == b else "&" if b == " " else b for a, b in pairs) + "\n\n")
        before = head
        for n in range(len(names)):
            if n not in here:
                since[n] = 0
                continue
            order = min(since[n], 3)
            last = np.diff(values[k - order : k + 1, n], order, axis=0)[-1]
            parts.append(" ".join(f"{'' if since[n] else '3&'}{value}" for value in last) + "\n")
            since[n] += 1
    return "".join(parts).encode(), values


def test_a_compact_file_of_four_systems_takes_little_more_than_its_columns(tmp_path):
    """A day at 1 Hz is the same: 4.1 million rows, 406 MB, and 58 MB beside them."""
    content, values = make_crinex(120, 6)
    path = tmp_path / "a.crx.gz"
    path.write_bytes(gzip.compress(content, 1))
    read_observations(path)  # modules are loaded
    seen, peak = peak_memory(lambda path: read_observations(path, phase=True), path)
    assert np.bincount(seen.system).tolist() == [720, 720, 720, 715]  # GPS, GLONASS, Galileo, BeiDou
    rows = np.ones(values.shape[:2], bool)
    rows[20:25, 2] = False
    found = np.stack([seen.pseudorange, seen.phase, seen.doppler, seen.cn0], axis=-1)[:, 0]
    assert np.array_equal(found, values[rows] / 1000.0)
    assert seen.t.tolist() == list(range(120))
    columns = sum(one.nbytes for one in dataclasses.astuple(seen) if isinstance(one, np.ndarray))
    assert peak < 1.5 * columns + 4 * unpacking.BLOCK  # arrays grow ahead, and small numbers lie twice


def line_of_crinex(path):
    path.write_bytes(gzip.compress(make_head().encode() + b"9" * 20_000_000))
    return read_observations


def line_of_rinex(path):
    head = make_head().splitlines(keepends=True)[2:]
    path.write_bytes(gzip.compress("".join(head).encode() + b"9" * 20_000_000))
    return read_observations


def codes_of_long_texts(path):
    """Each code of the file stands for the text of the one before and its first letter again."""
    path.write_bytes(write_codes([97, *range(257, 7000)]))
    return read_observations


def bytes_of_a_receiver(path):
    path.write_bytes(gzip.compress(b"\xb5\x62\x02\x15" + b"\xb5\x62" * 10_000_000))
    return read_ubx


def letters_of_matlab(path):
    savemat(path, {"words": " " * 10_000_000, "t": np.arange(3.0)}, do_compression=True)
    return lambda path: mat_file.read_mat(path)["t"].tolist()


def elements_of_a_track(path):
    path.write_bytes(b"<a>" * 500_000)
    return read_track


@pytest.mark.parametrize(
    ("name", "make", "words"),
    [
        ("a.crx.gz", line_of_crinex, "line 9: the epoch cannot be restored"),
        ("a.rnx.gz", line_of_rinex, "line 7: is longer than 4096 characters: not a RINEX file"),
        ("a.rnx.Z", codes_of_long_texts, "line 1: is longer than 4096 characters: not a RINEX file"),
        ("a.ubx.gz", bytes_of_a_receiver, "has no raw measurements"),
        ("a.mat", letters_of_matlab, "[0.0, 1.0, 2.0]"),
        ("a.gpx", elements_of_a_track, "more than 100 elements within each other"),
    ],
)
def test_a_small_file_that_unpacks_to_a_large_one_takes_little_memory(tmp_path, name, make, words):
    path = tmp_path / name
    read = make(path)
    found, peak = peak_memory(read, path)
    assert words in str(found)
    assert peak < 4_000_000


@pytest.mark.parametrize(
    "content",
    [b"", b"a", b"a" * 50_000, b"abc" * 9000, np.random.default_rng(1).bytes(90_000), b"ab\r\n" + bytes(999)],
)
def test_a_z_file_gives_its_content_back(tmp_path, content):
    """Texts longer than what the table holds of one, and as many codes as it holds."""
    path = tmp_path / "a.Z"
    path.write_bytes(compress(content))
    with unpacking.open_binary(path, "a.Z") as file:
        assert file.read() == content


def test_the_packer_of_these_tests_is_that_of_unix():
    packed, plain = (stored_gnss_file(f"07590920.05o.{ending}").read_bytes() for ending in ("Z", "gz"))
    assert compress(gzip.decompress(plain)) == packed


def test_what_unpacks_to_too_much_is_refused_in_every_reader(tmp_path, monkeypatch):
    monkeypatch.setattr(unpacking, "MOST_UNPACKED", 100_000)
    with pytest.raises(ConfigError, match=r"F9T-L2-2min\.ubx\.gz: unpacks to more than 0\.0001 GB"):
        read_ubx(stored_gnss_file(F9T))
    for path in (tmp_path / "a.gz", tmp_path / "a.Z"):
        content = make_head().encode() * 300
        path.write_bytes(compress(content) if path.suffix == ".Z" else gzip.compress(content))
        with pytest.raises(ConfigError, match=rf"{path.name}: unpacks to more than 0\.0001 GB"):
            read_observations(path)
    monkeypatch.setattr(mat_file, "MOST_BYTES", 10_000_000)
    savemat(tmp_path / "a.mat", {"small": np.zeros(3_000_000, np.uint8)}, do_compression=True)
    with pytest.raises(ConfigError, match=r"a\.mat: larger than 10 MB when unpacked"):
        mat_file.read_mat(tmp_path / "a.mat")  # bytes become numbers of eight


def test_a_receivers_file_packed_by_compress_is_read_too(tmp_path):
    path = tmp_path / "a.ubx.Z"
    path.write_bytes(compress(gzip.decompress(stored_gnss_file(F9T).read_bytes())[:20_000]))
    assert find_kind(path, path.name) == "ubx"
    assert len(read_ubx(path).t) > 5


@pytest.mark.parametrize("value", ["9" * 400, "99999999999999", "-1000000000000"])
def test_a_value_that_is_wider_than_its_field_costs_the_epoch(tmp_path, value):
    lines = make_crinex(40, 1)[0].decode().splitlines(keepends=True)
    at = len(make_head().splitlines()) + 2
    lines[at] = f"3&{value} " + lines[at].partition(" ")[2]
    path = tmp_path / "a.crx"
    path.write_text("".join(lines))
    with pytest.raises(
        ConfigError, match=r"has no epoch that can be read; line 11: the epoch cannot be restored"
    ):
        read_observations(path)


def test_an_orbit_file_with_too_many_positions_or_a_power_is_told(tmp_path, monkeypatch):
    packed = stored_gnss_file("COD0IGSRAP_20210780000_15M_ORB.SP3.gz").read_bytes()
    path = tmp_path / "a.sp3"
    path.write_bytes(gzip.decompress(packed).replace(b"++         5", b"++         \xb2", 1))
    assert len(read_precise_orbits(path).names) == 20
    monkeypatch.setattr(precise_orbits, "MOST_POSITIONS", 100)
    with pytest.raises(ConfigError, match="more than 100 positions of satellites"):
        read_precise_orbits(path)


def test_a_track_with_too_many_elements_is_refused(tmp_path, monkeypatch):
    monkeypatch.setattr(model_files, "MOST_ELEMENTS", 1000)
    (tmp_path / "a.gpx").write_bytes(b"<gpx>" + b"<a/>" * 1000 + b"</gpx>")
    with pytest.raises(ConfigError, match="more than 1000 elements"):
        read_track(tmp_path / "a.gpx")
