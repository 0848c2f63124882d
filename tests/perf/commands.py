"""What whole commands and first runs cost in starts of Python, and in compilations of a fixed kernel."""

from __future__ import annotations

import importlib.util
import pickle
import shutil
import tempfile
from dataclasses import fields, replace
from pathlib import Path

import bench
from bench import pipeline
from bench.core.records.data import Trajectory
from bench.core.records.specs import Profile
from bench.io import config
from bench.views.report import page
from tests.perf.dense import EPOCHS, dense
from tests.perf.units import COMPILE, START, Costs, Figure, child, compare, cpu

COMMAND = "from bench.__main__ import main; main()"
WITHOUT_PANDAS = f"""
import sys
class NoPandas:
    @staticmethod
    def find_spec(name, path=None, target=None):
        if name.partition(".")[0] == "pandas":
            raise ModuleNotFoundError(f"No module named {{name!r}}", name=name)
sys.meta_path.insert(0, NoPandas)
{COMMAND}
"""


def command(words: str, cwd: Path, cache: Path, start: str = COMMAND) -> Costs:
    """Return the CPU time of a ``bench`` command, as costs."""
    # as it is where bench is installed: bytecode is kept
    return child("-c", start, *words.split(), cwd=cwd, BENCH_CACHE=str(cache), PYTHONDONTWRITEBYTECODE="")


def reporting(profile: Profile) -> list[Figure]:
    """The report of a run with the filters of its profile."""
    result = bench.run(profile)
    cost = compare(cpu(lambda: page.make_page(profile.name, result)), cpu(dense))
    return [cost.hold(f"report of {profile.name} / {EPOCHS} epochs of dense", 1.5)]


def warm() -> list[Figure]:
    """Commands where everything is compiled and cached, with pandas and without."""
    verbs = {
        "run figure-eight --no-causes --force -o again": ("bench run figure-eight --no-causes", 33.0),
        "fly figure-eight": ("bench fly figure-eight", 6.0),
        "list": ("bench list", 6.5),
        "--help": ("bench --help", 1.0),
    }
    starts = {"without pandas": WITHOUT_PANDAS}
    if importlib.util.find_spec("pandas"):
        starts["with pandas"] = COMMAND
    else:
        print("pandas is not installed: commands beside it are left out (make perf installs it)")
    figures = []
    with tempfile.TemporaryDirectory() as folder:
        there, cache = Path(folder), Path(folder) / "cache"
        for verb, (what, limit) in verbs.items():
            for where, start in starts.items():
                cost = compare(command(verb, there, cache, start), START)
                figures.append(cost.hold(f"{what}, warm, {where} / starts of Python", limit))
        size = (there / "again" / "flight.rrd").stat().st_size / 1e6
        figures.append(Figure("recording of figure-eight", size, 15.0, "MB"))
    return figures


def first() -> list[Figure]:
    """First runs, where no kernel is compiled."""
    with tempfile.TemporaryDirectory() as folder:
        there, cache = Path(folder), Path(folder) / "cache"
        fly = command("fly figure-eight", there, cache)

        def cold(words: str, *, flown: bool) -> Costs:
            def spend() -> float:
                shutil.rmtree(cache, ignore_errors=True)
                if flown:
                    fly()
                    shutil.rmtree(cache / "kernels", ignore_errors=True)
                return command(words, there, cache)()

            return spend

        whole, one = (
            "run figure-eight --no-causes --force -o first",
            "run figure-eight -e loose-22 --force -o first",
        )
        warm = command(whole, there, cache)
        rows = [
            compare(cold(whole, flown=False), COMPILE, 3).hold("first bench run / fixed compilations", 30.0),
            compare(cold(one, flown=True), COMPILE, 3).hold(
                "first run of loose-22, truth cached / the same", 28.0
            ),
        ]
        return [
            *rows,
            compare(cold(whole, flown=False), warm, 2).hold("first bench run / the same, warm", 11.0),
        ]


FIRST_ANSWER = """
import pickle, sys
from bench.navigation.built_in import BUILT_IN, load
with open(sys.argv[1], "rb") as file:
    data, initial = pickle.load(file)
for name in sys.argv[2:] or [use for use, row in BUILT_IN.items() if row.package is None]:
    load(name, {}).run(data, initial)
"""


def starting(truth: Trajectory) -> list[Figure]:
    """First answers to two seconds of a record, each in a process of its own: compiling, and compiled."""
    sensed = pipeline.sense(config.read_profile("figure-eight", {"sensors.gnss": "sky-l1"}), truth)
    imu = sensed.data.imu
    begun = {f.name: getattr(imu, f.name)[:400] for f in fields(imu)}
    data = replace(sensed.data, imu=replace(imu, **begun), output_t=sensed.data.output_t[:21])
    with tempfile.TemporaryDirectory() as folder:
        given, cache = Path(folder) / "given.pickle", Path(folder) / "cache"
        given.write_bytes(pickle.dumps((data, sensed.initial)))

        def process(*names: str) -> Costs:
            return child("-c", FIRST_ANSWER, str(given), *names, BENCH_CACHE=str(cache))

        def cold() -> float:
            shutil.rmtree(cache, ignore_errors=True)
            return process()()

        return [
            compare(cold, COMPILE, 2).hold("all built-in filters, first ever / fixed compilations", 50.0),
            compare(process("loose-22"), START).hold(
                "loose-22, kernels warm, to its first answer / starts of Python", 13.0
            ),
        ]
