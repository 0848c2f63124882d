"""MATLAB files of version 7.3: the same structures as of version 5, and nothing of other files."""

from __future__ import annotations

import zlib

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from scipy.io import loadmat, savemat

from bench.cli.command_line import main
from bench.core.words.exceptions import ConfigError
from bench.io.config.log import load_log
from bench.io.logs.log_records import read_records
from bench.io.logs.mat_files import mat_file
from bench.io.logs.mat_files.mat_file import read_mat
from tests.data import HERE
from tests.exchange import drives
from tests.exchange.matlab_hdf5 import write_hdf5
from tests.exchange.test_log_tables import write_structures
from tests.fuzz import judge

h5py = pytest.importorskip("h5py")


def test_a_file_that_matlab_wrote():
    """``testdouble = 0:pi/4:2*pi`` of the tests of SciPy."""
    found = read_mat(HERE / "matlab" / "testdouble-7.4.mat")
    assert list(found) == ["testdouble"]
    assert_allclose(found["testdouble"], np.arange(9) * np.pi / 4, rtol=0, atol=1e-15)


def test_both_versions_give_the_same_structures(tmp_path):
    """Orders of axes, kinds of numbers, empty arrays, texts, structures in structures."""
    random = np.random.default_rng(3)
    unit = {"t": np.arange(500.0), "wb": random.normal(size=(500, 3)), "name": "ADIS16475"}
    unit |= {"flags": np.array([True, False]), "count": np.arange(6, dtype=np.int32).reshape(2, 3)}
    variables = {
        "flight": {"imu": unit, "spare": {"one": 7.5, "none": np.empty((0, 3)), "cube": np.zeros((2, 3, 4))}},
        "single": np.float32([1.5, -2.5]),
    }
    variables["flight"]["spare"]["cube"][:] = np.arange(24.0).reshape(2, 3, 4)
    savemat(tmp_path / "v5.mat", variables, oned_as="column")
    write_hdf5(tmp_path / "v73.mat", variables)
    assert_same(read_mat(tmp_path / "v73.mat"), read_mat(tmp_path / "v5.mat"))


def assert_same(found, expected):
    if not isinstance(expected, dict):
        assert_array_equal(found, expected)
        assert getattr(found, "dtype", None) == getattr(expected, "dtype", None)
        return
    assert set(found) == set(expected)
    for name in expected:
        assert_same(found[name], expected[name])


def test_a_log_reads_it_by_every_way(tmp_path, capsys):
    """NaveGo's structures by topic, and `bench new log` by what is in the file."""
    path = drives.write_log(tmp_path)
    plain = read_records(load_log(str(path)))
    write_structures(tmp_path, "imu1")
    content = loadmat(tmp_path / "all.mat", simplify_cells=True)
    write_hdf5(tmp_path / "all.mat", {"flight": content["flight"]})
    path.write_text(drives.LOG.replace('file = "imu.csv"', 'file = "all.mat"\ntopic = "imu1"'))
    found = read_records(load_log(str(path)))
    assert_allclose(found.imu.dtheta_b, plain.imu.dtheta_b, atol=1e-12)
    assert main(["new", "log", str(tmp_path / "all.mat")]) == 0
    assert "gnss1" in (tmp_path / "all.toml").read_text()
    records = read_records(load_log(str(tmp_path / "all.toml")))
    assert_allclose(records.fixes.lla, plain.fixes.lla, atol=1e-9)


def mark(item, kind="double"):
    item.attrs["MATLAB_class"] = np.bytes_(kind)


def test_nothing_but_numbers_of_the_file_is_read(tmp_path):
    """Links, external and virtual data, references, complex numbers, arrays of structures, loops."""
    write_hdf5(tmp_path / "other.mat", {"secret": np.arange(5.0)})
    (tmp_path / "raw.bin").write_bytes(np.arange(5.0).tobytes())
    with h5py.File(tmp_path / "a.mat", "w", userblock_size=512) as file:
        file["linked"] = h5py.ExternalLink(str(tmp_path / "other.mat"), "/secret")
        file["soft"] = h5py.SoftLink("/x")
        mark(file.create_dataset("x", data=np.arange(4.0)[None]))
        mark(file.create_dataset("outside", (5,), "f8", external=str(tmp_path / "raw.bin")))
        layout = h5py.VirtualLayout((1, 5), "f8")
        layout[:] = h5py.VirtualSource(str(tmp_path / "other.mat"), "secret", (1, 5))
        mark(file.create_virtual_dataset("virtual", layout))
        mark(file.create_dataset("cell", data=np.array([[file["x"].ref]], h5py.ref_dtype)), "cell")
        mark(file.create_dataset("complex", data=np.array([(1.0, 2.0)], [("real", "f8"), ("imag", "f8")])))
        mark(file.create_group("many"), "struct")
        file["many"].create_dataset("t", data=np.array([[file["x"].ref]], h5py.ref_dtype))
        mark(file.create_group("#refs#"), "struct")
        mark(file.create_group("loop"), "struct")
        file["loop/again"] = file["loop"]
        mark(file.create_group("away"), "struct")
        file["away/there"] = h5py.ExternalLink(str(tmp_path / "other.mat"), "/secret")
    found = read_mat(tmp_path / "a.mat")
    assert_array_equal(found.pop("x"), np.arange(4.0))
    assert found.pop("loop")["again"]["again"]["again"] == {"again": None}
    assert found.pop("away") == {}
    assert found == dict.fromkeys(("outside", "virtual", "cell", "complex", "many"))


def test_what_is_too_large_or_of_another_program_is_one_line(tmp_path, monkeypatch):
    path = tmp_path / "a.mat"
    with h5py.File(path, "w") as file:
        file.create_dataset("x", data=np.arange(4.0))
    with pytest.raises(ConfigError, match=r"a\.mat: HDF5 without MATLAB_class, so not of MATLAB; save"):
        read_mat(path)
    with h5py.File(path, "w") as file:
        mark(file.create_dataset("x", (1, 10**13), "f8", chunks=(1, 1000)))
    with pytest.raises(ConfigError, match=r"a\.mat: larger than 1000 MB when unpacked"):
        read_mat(path)
    with h5py.File(path, "w") as file:
        mark(file.create_dataset("x", data=np.arange(1000.0)[None], compression="lzf"))
    with pytest.raises(ConfigError, match="packed by a filter that MATLAB does not have"):
        read_mat(path)
    packer = zlib.compressobj(9)
    blocks = [packer.compress(bytes(1 << 20)) for _ in range(600)]
    with h5py.File(path, "w") as file:
        mark(file.create_dataset("x", (1, 1000), "f8", chunks=(1, 1000), compression="gzip"))
        file["x"].id.write_direct_chunk((0, 0), b"".join([*blocks, packer.flush()]))
    monkeypatch.setattr(mat_file, "MOST_BYTES", 10_000_000)
    with pytest.raises(ConfigError, match=r"a\.mat: (cannot be read|larger than)"):
        read_mat(path)
    write_hdf5(path, {"x": np.zeros(1_300_000, np.uint8)})  # they become doubles
    with pytest.raises(ConfigError, match=r"a\.mat: larger than 10 MB when unpacked"):
        read_mat(path)
    monkeypatch.setitem(__import__("sys").modules, "h5py", None)
    with pytest.raises(ConfigError, match="needs the package h5py: pip install h5py, or save it with -v7"):
        read_mat(path)


def test_damaged_files_are_read_or_rejected(tmp_path):
    write_hdf5(tmp_path / "whole.mat", {"imu": {"t": np.arange(300.0), "wb": np.ones((300, 3))}})
    whole, path = (tmp_path / "whole.mat").read_bytes(), tmp_path / "a.mat"
    random = np.random.default_rng(7)
    for k in range(150):
        damaged = bytearray(whole[: random.integers(len(whole))] if k < 50 else whole)
        for _ in range(int(k >= 50) * int(random.integers(1, 4))):
            damaged[random.integers(512, len(damaged))] = random.integers(256)
        path.write_bytes(damaged)
        outcome, raised = judge(read_mat, path)
        assert outcome != "failed", raised
