"""Make every write, sync and rename of what bench keeps fail in turn, as databases test theirs.

``python -m tests.faults [POINTS]`` strikes a drawn sample of the points of a run, a campaign, a card, a
check, a baseline, a saved filter, an export and the cache of truths, ``all`` every one: the disk is full
(ENOSPC), it fails (EIO), the process is killed, or killed in the middle of a write. Afterwards what was there
before, or what was to be written, must be whole, and the next command must work and leave nothing behind.
Each point is a process of its own, forked from one in which all is loaded and flown; every processor takes
its share.
"""

from __future__ import annotations

import contextlib
import errno
import hashlib
import multiprocessing
import os
import random
import shutil
import signal
import sys
import tempfile
import time
import traceback
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

import bench
from bench.cli import saving
from bench.core.files import durable
from bench.core.files.scratch import LOCK, PREFIX, remove_abandoned
from bench.core.words.exceptions import BenchError
from bench.core.words.stages import Stage
from bench.experiments.baselines import checking
from bench.experiments.baselines.baseline_file import read_baseline, write_baseline
from bench.experiments.baselines.checking import record_baselines, write_change
from bench.experiments.baselines.junit import write_junit
from bench.experiments.campaigns.campaign_tables import EPOCHS, RUNS
from bench.experiments.campaigns.journal import NAME, Journal
from bench.experiments.campaigns.pools import SerialExecutor
from bench.experiments.card.card_making import Card, Line
from bench.io import results as store
from bench.io.results import truth_cache
from bench.views.report import card_page

PROFILE = """
title    = "A flight that is struck"
aircraft = "aerosonde"
rate_hz  = 100

[start]
lat_deg = 47.26
lon_deg = 11.34
alt_m   = 1200.0
heading_deg = 85.0

[[leg]]
kind = "straight"
duration_s = 20.0

[sensors]
imu  = "adis16475"
gnss = "matched-white"
baro = "bmp388"

[evaluation]
from_s = 5.0

[[estimator]]
use = "loose-15"
"""

WAYS = ("ENOSPC", "EIO", "killed", "torn")
SOUND, TOLD, BROKEN = 0, 1, 2
"""How a struck command ends: as if nothing were, with an error that is told, or with a bug's traceback."""


@dataclass(frozen=True)
class Work:
    """What is struck: a command that writes below a folder, and what is whole there."""

    name: str
    write: Callable[[Path, int], object]  # folder, version: writes version 1, then again as version 2
    whole: Callable[[Path], int | None]  # the version that is whole there; None: there is nothing


class _Strike:
    """Fails at the point number ``at``, counted from 0; counts all points."""

    def __init__(self, at: int, way: str) -> None:
        self.at, self.way, self.points = at, way, list[str]()

    def __call__(self, action: str, path: Path) -> None:
        now = len(self.points)
        self.points.append(f"{action} {path.name}")
        if now != self.at:
            return
        if self.way == "ENOSPC":
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC), str(path))
        if self.way == "EIO":
            raise OSError(errno.EIO, os.strerror(errno.EIO), str(path))
        if self.way == "torn" and action == "write":
            part = path if path.exists() else path.with_name(f".{path.name}.{os.getpid()}.part")
            with contextlib.suppress(OSError), part.open("ab") as file:
                file.write(b"\x00half of what was to be written")
        os.kill(os.getpid(), signal.SIGKILL)


def _in_child(work: Callable[[], object]) -> tuple[int, str]:
    """Do something in a forked process; return how it ends (-1: killed) and what it printed."""
    with tempfile.TemporaryFile() as told:
        sys.stdout.flush()
        sys.stderr.flush()
        child = os.fork()
        if not child:
            os.dup2(told.fileno(), 1)
            os.dup2(told.fileno(), 2)
            end = SOUND
            try:
                work()
            except (OSError, BenchError) as error:
                print(error)
                end = TOLD
            except BaseException:
                traceback.print_exc()
                end = BROKEN
            sys.stdout.flush()
            sys.stderr.flush()
            os._exit(end)
        _, status = os.waitpid(child, 0)
        told.seek(0)
        text = told.read().decode(errors="replace")
    return (os.WEXITSTATUS(status) if os.WIFEXITED(status) else -1), text


def _strike(work: Work, folder: Path, at: int, way: str) -> tuple[int, str]:
    def struck() -> None:
        durable.before = _Strike(at, way)
        work.write(folder, 2)

    return _in_child(struck)


def list_points(work: Work, folder: Path) -> list[str]:
    """Return the points of a command that replaces what an earlier one wrote."""
    read, write = os.pipe()

    def counted() -> None:
        strike = _Strike(-1, "")
        durable.before = strike
        work.write(folder, 2)
        os.write(write, "\n".join(strike.points).encode())

    try:
        end, text = _in_child(counted)
        assert end == SOUND, text
        return os.read(read, 1 << 20).decode().split("\n")
    finally:
        os.close(read)
        os.close(write)


def left_behind(folder: Path) -> list[str]:
    """Return files and folders that no finished command leaves."""
    return [
        str(path.relative_to(folder))
        for path in folder.rglob(".*")
        if (path.name.startswith(".bench-") and path.name != ".bench.json") or path.name.endswith(".part")
    ]


def check_point(work: Work, before: Path, folder: Path, at: int, way: str) -> tuple[str, str]:
    """Strike one point; return the state found and what is wrong, empty if nothing is."""
    _copy(before, folder)
    end, told = _strike(work, folder, at, way)
    wanted = (SOUND, TOLD) if way in ("ENOSPC", "EIO") else (-1, SOUND)
    if end not in wanted:
        return "-", f"ended with {end}: {told.strip()[-2000:]}"
    try:
        found = work.whole(folder)
    except Exception as error:
        return "damaged", f"{type(error).__name__}: {error}"
    if way in ("ENOSPC", "EIO") and (rest := left_behind(folder)):
        return f"version {found}", f"left behind: {', '.join(rest)}"
    if found is None:  # killed between two renames: the next command in this place moves the old one back
        remove_abandoned(folder)
        found = work.whole(folder)
    if found is None:
        return "nothing", "what was there before is gone"
    again, told = _in_child(lambda: work.write(folder, 2))
    if again != SOUND:
        return f"version {found}", f"the next command fails: {told.strip()[-2000:]}"
    if work.whole(folder) != 2:
        return f"version {found}", "the next command did not write its result"
    if rest := left_behind(folder):
        return f"version {found}", f"left behind for good: {', '.join(rest)}"
    return f"version {found}", ""


# --- what is struck -------------------------------------------------------------------------------------


def digest(folder: Path) -> dict[str, str]:
    """Return the hash of each finished file in a folder."""
    files = (path for path in sorted(folder.rglob("*")) if path.is_file() and path.name != LOCK)
    return {
        path.relative_to(folder).as_posix(): hashlib.sha256(path.read_bytes()).hexdigest()
        for path in files
        if not any(part.startswith(PREFIX) for part in path.parts) and not durable.is_part(path.name)
    }


def replaced(name: str, write: Callable[[Path, int], object], place: Path, *, partly: bool = False) -> Work:
    """Return a work whose two versions are known to the bit: as a whole, or ``partly`` file by file."""
    known: dict[int, dict[str, str]] = {}
    for version in (1, 2):
        folder = place / f"known-{name}-{version}"
        folder.mkdir()
        for before in range(1, version + 1):
            write(folder, before)
        known[version] = digest(folder)
    assert known[1] != known[2], name

    def whole(folder: Path) -> int | None:
        found = digest(folder)
        if not found:
            return None
        if partly and found not in known.values():
            assert found.keys() <= known[2].keys(), sorted(found)
            for file, of in found.items():
                assert of in (known[1].get(file), known[2][file]), f"{file} is neither old nor new"
            return 1
        assert found in known.values(), f"neither old nor new: {sorted(found)}"
        return 1 if found == known[1] else 2

    return Work(name, write, whole)


def make_card(name: str) -> Card:
    """Return a card of two lines."""
    line = Line(
        topic="convergence", flight="short", figure="draws", value=1.0, low=None, high=None,
        word="count", by_draw=(1.0,), sentence="It converged.",
    )  # fmt: skip
    error = line.model_copy(
        update={"topic": "accuracy", "figure": "horizontal", "word": "", "low": 0.5, "high": 2.0}
    )
    return Card(
        estimator=name, against="loose-22", suite="quick 1", suite_hash="0" * 64, draws=1, versions={},
        speed=None, lines=(line, error),
    )  # fmt: skip


def works(place: Path) -> list[Work]:
    """Return what is struck; everything is loaded and flown here, once. ``place`` is an empty folder."""
    source = place / "short.toml"
    source.write_text(PROFILE, encoding="utf-8")
    results = {k: bench.run(str(source), seed=k) for k in (1, 2)}
    estimators = {1: ["free-inertial"], 2: ["loose-15"]}
    verdicts, baselines = {}, {}
    for k, asked in estimators.items():
        (path,) = record_baselines(
            [str(source)], directory=place / f"baseline-{k}", estimators=asked, runs=20
        )
        baselines[k] = read_baseline(path)
        verdicts[k] = list(checking.check([str(source)], directory=place / f"baseline-{k}"))
    cards = {k: make_card(name) for k, (name,) in estimators.items()}
    sensed = results[1].sensed
    filters = {}
    for k, look_back in ((1, 0.5), (2, 1.0)):
        filters[k] = bench.open_filter("loose-15", sensed.initial, look_back=look_back)
        filters[k].update(sensed.data)
    saved = {
        k: saving.write_result(results[k], place / f"saved-{k}", recording=False, report=False)
        for k in (1, 2)
    }
    truths = {k: result.truth for k, result in results.items()}

    def write_run(folder: Path, version: int) -> None:
        saving.write_result(results[version], folder / "run", recording=False, report=False, force=True)

    def write_report(folder: Path, version: int) -> None:
        if version == 1:
            write_run(folder, 1)
        else:
            saving.write_report(folder / "run", results[1])

    def write_card(folder: Path, version: int) -> None:
        store.write_json(folder / "card.json", cards[version].model_dump())
        card_page.write_card(folder / "card.html", cards[version])

    def write_check(folder: Path, version: int) -> None:
        write_junit(folder / "check.xml", verdicts[version])

    def write_baselines(folder: Path, version: int) -> None:
        old = folder / "short.json"
        before = read_baseline(old) if old.exists() else None
        write_baseline(folder, baselines[version])
        write_change(folder, before, baselines[version], "a reason")

    def whole_baselines(folder: Path) -> int | None:
        if not (folder / "short.json").exists():
            return None
        names = read_baseline(folder / "short.json").estimators.keys()
        assert (folder / checking.CHANGES).read_text(encoding="utf-8").endswith(".*\n")
        return next(k for k, one in baselines.items() if one.estimators.keys() == names)

    def write_filter(folder: Path, version: int) -> None:
        bench.write_filter(filters[version], folder / "filter.npz")

    def write_export(folder: Path, version: int) -> None:
        bench.export_run(saved[version], "csv", out=folder / "csv", force=True)

    def campaign(folder: Path, version: int) -> None:
        """Run the first run, interrupted; then go on to the second."""

        def stop(progress: Stage) -> None:
            if version == 1 and progress.done == 1:
                raise KeyboardInterrupt

        out = folder / "campaign"
        bench.campaign(str(source), 2, executor=SerialExecutor(), jobs=1, out=out, resume=True, progress=stop)

    def whole_campaign(folder: Path) -> int | None:
        out = folder / "campaign"
        with Journal(out / NAME) as journal:
            done = len(journal._places)
        for name in (RUNS, EPOCHS):
            if (out / name).exists():
                store.read_table(out / name)
        if not done:
            return None
        runs = bench.read_campaign(out).runs if done == 2 and (out / store.CAMPAIGN_RESULT).exists() else ()
        return 2 if len(runs) == 2 else 1

    def cached(folder: Path) -> None:
        os.environ["BENCH_CACHE"] = str(folder)

    def write_cache(folder: Path, version: int) -> None:
        cached(folder)
        truth_cache.write_truth(f"key-{version}", truths[version])

    def whole_cache(folder: Path) -> int | None:
        found = [k for k in (1, 2) if _in_child(lambda k=k: read_cache(folder, k))[0] == SOUND]
        return max(found, default=None)

    def read_cache(folder: Path, version: int) -> None:
        cached(folder)
        truth = truth_cache.read_truth(f"key-{version}")
        if truth is None:
            raise OSError("not there")
        assert np.array_equal(truth.lla, truths[version].lla)

    return [
        replaced("run", write_run, place),
        replaced("report", write_report, place, partly=True),
        replaced("export", write_export, place),
        replaced("card", write_card, place, partly=True),
        replaced("check", write_check, place),
        replaced("filter", write_filter, place),
        Work("baseline", write_baselines, whole_baselines),
        Work("campaign", campaign, whole_campaign),
        Work("cache", write_cache, whole_cache),
    ]


def strike(points: int | None, seed: int, say: Callable[[str], object] = print) -> list[str]:
    """Strike a drawn sample of all points, all if None; print a line for each work; return what is wrong."""
    draw, wrong = random.Random(seed), list[str]()
    with tempfile.TemporaryDirectory() as scratch:
        place = Path(scratch)
        every = []
        for work in works(place):
            before = place / f"before-{work.name}"
            before.mkdir()
            end, told = _in_child(lambda work=work, before=before: work.write(before, 1))
            assert end == SOUND, told
            listed = list_points(work, _copy(before, place / "counted"))
            every += [(work, before, at, name, way) for at, name in enumerate(listed) for way in WAYS]
        chosen = every if points is None else draw.sample(every, min(points, len(every)))

        def check(index: int) -> tuple[str, str]:
            work, before, at, _, way = chosen[index]
            return check_point(work, before, place / f"struck-{os.getpid()}", at, way)

        states: dict[str, Counter[str]] = {}
        for (work, _, at, name, way), (state, fault) in zip(
            chosen, _in_workers(check, len(chosen)), strict=True
        ):
            states.setdefault(work.name, Counter())[state] += 1
            if fault:
                wrong.append(f"{work.name}, {way} at point {at} ({name}): {fault}")
        for name, found in states.items():
            listed = ", ".join(f"{state} {count} times" for state, count in sorted(found.items()))
            say(f"{name}: {found.total()} points struck; {listed}")
    return wrong


_work: Callable[[int], tuple[str, str]]


def _in_workers(work: Callable[[int], tuple[str, str]], count: int) -> list[tuple[str, str]]:
    """Return what some work gives for 0, 1, ...; every processor forks a worker that has all in memory."""
    global _work
    _work = work
    with multiprocessing.get_context("fork").Pool() as pool:
        return pool.map(_do, range(count), chunksize=1)


def _do(index: int) -> tuple[str, str]:
    return _work(index)


def _copy(before: Path, folder: Path) -> Path:
    shutil.rmtree(folder, ignore_errors=True)
    return Path(shutil.copytree(before, folder, symlinks=True))


def main() -> int:
    """Strike as many points as asked for, 200 by default; return the exit status."""
    begun = time.perf_counter()
    asked = sys.argv[1] if len(sys.argv) > 1 else "200"
    wrong = strike(None if asked == "all" else int(asked), seed=1)
    print(*wrong, sep="\n")
    print(f"{len(wrong)} faults in {time.perf_counter() - begun:.0f} s" if wrong else
          f"all whole, in {time.perf_counter() - begun:.0f} s")  # fmt: skip
    return 1 if wrong else 0


if __name__ == "__main__":
    sys.exit(main())
