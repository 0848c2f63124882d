"""Compiled code is never stale: the cache folder is named by every source that uses the compiler."""

import gc
import os
import pickle
import shutil
import subprocess
import sys
import time
from pathlib import Path
from typing import NamedTuple

import numba
import numpy as np
import pytest

from bench.core.compilation import compiled, kernel_locks
from bench.core.files import places
from bench.core.mathematics import earth
from tests import kernel_modes

ANSWER = """
import sys, shutil, pathlib
from bench.core.compilation import compiled
from bench.core.mathematics import earth
print(earth.radii_kernel(0.0)[1], compiled.choose_cache())
"""


def copy_of_the_package(folder: Path) -> Path:
    for source in places.PACKAGE.rglob("*.py"):
        target = folder / "bench" / source.relative_to(places.PACKAGE)
        target.parent.mkdir(parents=True, exist_ok=True)
        target.write_bytes(source.read_bytes())
    return folder


def answer(folder: Path, cache: Path, variable: str) -> tuple[float, str]:
    environment = {k: v for k, v in os.environ.items() if k != "NUMBA_CACHE_DIR"}
    environment |= {"PYTHONPATH": str(folder), variable: str(cache)}
    done = subprocess.run(
        [sys.executable, "-c", ANSWER],
        cwd=folder,
        env=environment,
        capture_output=True,
        text=True,
        check=True,
    )
    value, where = done.stdout.split()
    return float(value), where


@pytest.mark.parametrize("variable", ["BENCH_CACHE", "NUMBA_CACHE_DIR"])
def test_a_constant_changed_in_another_module_is_seen(tmp_path, variable):
    """numba's own cache returns the old value here; the name of the folder must change."""
    folder, cache = copy_of_the_package(tmp_path / "tree"), tmp_path / "cache"
    before, first = answer(folder, cache, variable)
    again, same = answer(folder, cache, variable)
    assert (again, same) == (before, first)
    earth = folder / "bench/core/mathematics/earth.py"
    earth.write_text(earth.read_text().replace('"WGS-84", 6378137.0', '"WGS-84", 6378138.0'))
    after, second = answer(folder, cache, variable)
    assert (before, after) == (6378137.0, 6378138.0)
    assert second != first


def flip(data: bytes) -> bytes:
    middle = len(data) // 2
    return data[:middle] + bytes([data[middle] ^ 0x55]) + data[middle + 1 :]


@pytest.mark.skipif(compiled.is_plain(), reason="numba's own files have no sums")
def test_damaged_compiled_code_is_told_once_and_compiled_again(tmp_path):
    """Cut short, emptied, one bit-flipped byte, of index or code; then the cache is whole."""
    environment = {k: v for k, v in os.environ.items() if k != "NUMBA_CACHE_DIR"}
    environment |= {"PYTHONPATH": str(places.PACKAGE.parent), "BENCH_CACHE": str(tmp_path)}

    def run() -> tuple[str, str]:
        done = subprocess.run(
            [sys.executable, "-c", ANSWER], env=environment, capture_output=True, text=True, check=True
        )
        return done.stdout, done.stderr

    whole, silent = run()
    assert silent == ""
    for ending in (".nbi", ".nbc"):
        (file,) = tmp_path.rglob(f"*radii_kernel*{ending}")
        for damage in (lambda data: data[: len(data) // 2], lambda data: b"", flip):
            file.write_bytes(damage(file.read_bytes()))
            out, err = run()
            assert out == whole
            assert err.count("\n") == 1
            assert "is damaged; it is compiled again" in err
    assert run() == (whole, "")


def test_every_module_whose_values_kernels_take_names_the_cache(monkeypatch, tmp_path):
    """Also one without a kernel of its own, and one that is imported by such a one."""
    folder = copy_of_the_package(tmp_path)
    monkeypatch.setattr(compiled, "PACKAGE", folder / "bench")
    before = compiled.hash_sources()
    for name in (
        "bench/navigation/error_state_filter/schedule.py",
        "bench/navigation/error_state_filter/state_processes.py",
        "bench/core/records/data.py",
        "bench/core/records/sensor_specs.py",
        "bench/core/mathematics/units.py",
    ):
        path = folder / name
        path.write_text(path.read_text() + "\n# changed\n")
        after = compiled.hash_sources()
        assert after != before, name
        before = after
    cli = folder / "bench" / "cli" / "flights.py"
    cli.write_text(cli.read_text() + "\n# changed\n")
    assert compiled.hash_sources() == before


def test_another_process_finds_a_kernel_by_its_name():
    assert pickle.loads(pickle.dumps(earth.radii_kernel)) is earth.radii_kernel


def test_folders_unused_for_a_month_are_removed(tmp_path):
    old, young, keep = (tmp_path / name for name in ("old", "young", "keep"))
    for folder in (old, young, keep):
        folder.mkdir()
    month = 31 * 86400
    for folder in (old, keep):
        os.utime(folder, (time.time() - month,) * 2)
    compiled.remove_unused(tmp_path, keep=keep)
    assert sorted(f.name for f in tmp_path.iterdir()) == ["keep", "young"]


def test_cache_folder_follows_the_environment(monkeypatch, tmp_path):
    monkeypatch.setenv("BENCH_CACHE", str(tmp_path))
    assert places.cache_folder("truth") == tmp_path / "truth"
    monkeypatch.delenv("BENCH_CACHE")
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    assert places.cache_folder("truth") == tmp_path / "bench" / "truth"
    monkeypatch.delenv("XDG_CACHE_HOME")
    assert places.cache_folder("truth") == Path.home() / ".cache" / "bench" / "truth"


@pytest.mark.parametrize("module", ["numba", "jsbsim", "rerun", "pyarrow", "matplotlib", "filterpy"])
def test_importing_bench_imports_nothing_heavy(module):
    code = f"import sys, bench; sys.exit({module!r} in sys.modules or 'numpy' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0


@compiled.inner
def add_kernel(number, to):
    to[0] += number
    return 7


call = compiled.make_caller([add_kernel])


@compiled.kernel
def call_kernel(at, number, to):
    return call(at, number, to)


@compiled.kernel
def contain_kernel(number, to):
    return add_kernel(number, to)


def test_a_kernel_is_compiled_by_itself_only_where_its_address_is_asked_for():
    """With the shortcuts it has no machine code as a part of another one; by its address it does the same."""
    total = np.zeros(1)
    assert contain_kernel(1.5, total) == 7
    shortcuts = compiled.takes_shortcuts() and not compiled.is_plain()
    assert bool(add_kernel.dispatcher.signatures) != shortcuts
    at = compiled.find_address(add_kernel, compiled.types_of(1.5, total))
    assert len(add_kernel.dispatcher.signatures) == 1
    assert call_kernel(at, 1.5, total) == 7
    assert total[0] == 3.0


class Pair(NamedTuple):
    left: object
    right: object


def test_types_are_those_of_numba_and_equal_ones_are_one():
    """What makes another type for numba makes another one here: writing, order, shape, kind, nesting."""
    table = np.zeros((3, 4))
    frozen = table.view()
    frozen.flags.writeable = False
    values = [
        1, 1.5, True, None, np.int64(1), table, frozen, table.T, table[:, ::2], table[0], np.zeros(3, int),
        Pair(table, 1), Pair(frozen, 1), Pair(table, 1.0), Pair(Pair(1, 1), table), (table, 1),
    ]  # fmt: skip
    for one in values:
        for other in values:
            alike = numba.typeof(one) == numba.typeof(other)
            assert (compiled.types_of(one) is compiled.types_of(other)) <= alike
        assert compiled.types_of(one).kinds == (numba.typeof(one),)
    assert compiled.types_of(Pair(table, 1)) is compiled.types_of(Pair(np.ones((2, 2)), 7))


@pytest.mark.skipif(compiled.is_plain(), reason="plain kernels are compiled with all that they may call")
def test_a_filter_compiles_the_rows_of_the_sensors_it_reads_alone():
    """In a process of its own: a barometer was read, no magnetometer and no satellites."""
    code = """
from bench.simulation import sensors
from bench.navigation import built_in
from bench.navigation.error_state_filter.measurement_rows import BARO_ROWS, MAGNETIC_ROWS, ROWS
from bench.navigation.error_state_filter.ranges import ranging
from tests.weaving import units, weaving
sensed = sensors.sense(weaving(5.0, rate=100.0), units(), 1, 0)
built_in.load("loose-22", {}).run(sensed.data, sensed.initial)
made = [bool(k.dispatcher.signatures) for k in
        (ROWS[BARO_ROWS], ROWS[MAGNETIC_ROWS], ranging.satellites_kernel)]
assert made == [True, False, False], made
"""
    subprocess.run([sys.executable, "-c", code], check=True)


OTHER = "from bench.core.compilation import compiled; compiled._TRIED = ()"
RENAMED = """
from numba.core.caching import IndexDataCacheFile
begin = IndexDataCacheFile.__init__
def begin_otherwise(self, *arguments, **named):
    begin(self, *arguments, **named)
    self._other_name = self.__dict__.pop("_index_name")
IndexDataCacheFile.__init__ = begin_otherwise
"""


@pytest.mark.skipif(compiled.is_plain(), reason="these kernels are plain")
def test_a_numba_whose_parts_are_not_known_compiles_the_same(tmp_path, capsys):
    """Without the shortcuts; plain where an inner part has another name, and where it is asked for."""
    kernel_modes.main()
    plain, shortcuts, known = capsys.readouterr().out.split(" ", 2)
    assert (plain, known[:3]) == ("False", "21 ")
    for name, change, asked, mode in (
        ("other", OTHER, "", "False"),
        ("renamed", RENAMED, "", "True"),
        ("asked", "", "1", "True"),
    ):
        done = subprocess.run(
            [sys.executable, "-m", "tests.kernel_modes", change],
            cwd=places.PACKAGE.parent,
            env=os.environ | {"NUMBA_CACHE_DIR": str(tmp_path / name), "BENCH_PLAIN_KERNELS": asked},
            capture_output=True,
            text=True,
            check=False,
        )
        assert done.returncode == 0, done.stderr
        assert done.stdout == f"{mode} {name != 'other' and shortcuts} {known}"
        told = "bench: kernels are plain, and filters slower, with this numba: AttributeError: "
        assert done.stderr.startswith(told) == (name == "renamed")


@pytest.mark.long
@pytest.mark.skipif(compiled.is_plain(), reason="these kernels are plain")
def test_plain_kernels_give_filters_the_same_bits(tmp_path):
    """Every sensor, and what filters are made of; compiling it takes two minutes."""
    said = [
        subprocess.run(
            [sys.executable, "-m", "tests.kernel_modes", "", "loose-22", "tight", "smoother", "ukf"],
            cwd=places.PACKAGE.parent,
            env=os.environ | {"BENCH_PLAIN_KERNELS": asked},
            capture_output=True,
            text=True,
            check=True,
        ).stdout.splitlines()
        for asked in ("", "1")
    ]
    assert said[0][0].startswith("False ")
    assert said[1][0].startswith("True ")
    assert len(said[0]) == 6
    assert said[0][1:] == said[1][1:]


SHARED = """
from bench.core.compilation import compiled
from tests.kernel_modes import fill_kernel, sum_kernel, wide
kinds = compiled.types_of(0.1, wide((4, 8)), wide((4, 16)))
compiled.find_addresses([(fill_kernel, kinds), (sum_kernel, kinds)])
print(*(sum(one.dispatcher.stats.cache_misses.values()) for one in (fill_kernel, sum_kernel)))
"""


def compile_two(cache: Path) -> subprocess.Popen[str]:
    """Return a process that compiles `fill_kernel` and `sum_kernel`, and prints how often it did."""
    return subprocess.Popen(
        [sys.executable, "-c", SHARED],
        cwd=places.PACKAGE.parent,
        env=os.environ | {"NUMBA_CACHE_DIR": str(cache)},
        stdout=subprocess.PIPE,
        text=True,
    )


needs_locks = pytest.mark.skipif(
    compiled.is_plain() or sys.platform == "win32", reason="these kernels have no locks"
)


@needs_locks
def test_a_kernel_that_another_process_compiles_comes_last_and_is_not_compiled_twice(tmp_path):
    """This process is the other one: it holds the lock, and leaves the files of a cache filled before."""
    full, shared = tmp_path / "full", tmp_path / "shared"
    assert compile_two(full).communicate()[0] == "1 1\n"
    (index,) = full.rglob("*fill_kernel*.nbi")
    place = shared / index.parent.relative_to(full)
    kernel_locks.lock(place, index.name)
    with compile_two(shared) as child:
        while not list(place.glob("*sum_kernel*.nbc")):
            assert child.poll() is None
            time.sleep(0.01)
        for path in index.parent.glob("*fill_kernel*"):
            shutil.copy(path, place)
        kernel_locks.unlock(place, index.name)
        assert child.communicate()[0] == "0 1\n"


@needs_locks
def test_a_kernel_whose_process_was_killed_is_compiled_by_the_next(tmp_path):
    """The lock goes with its process: that of the first is taken, and the second waits until it is killed."""
    code = """
import sys, time
from pathlib import Path
from bench.core.compilation import kernel_locks
kernel_locks.lock(Path(sys.argv[1]), "kernel")
print("locked", flush=True)
time.sleep(600)
"""
    with subprocess.Popen(
        [sys.executable, "-c", code, str(tmp_path)], stdout=subprocess.PIPE, text=True
    ) as child:
        assert child.stdout.readline() == "locked\n"
        assert kernel_locks.is_locked(tmp_path, "kernel")
        assert not kernel_locks.is_locked(tmp_path, "another")
        child.kill()
    kernel_locks.lock(tmp_path, "kernel")
    assert not kernel_locks.is_locked(tmp_path, "kernel")


def test_nothing_is_collected_while_numba_compiles():
    seen = []
    with compiled.watch_compiling(lambda begins: seen.append((begins, gc.isenabled()))):
        assert compiled.kernel(_twice)(4.0) == 8.0
    assert seen == [(True, False), (False, True)]


def _twice(x):
    return 2.0 * x
