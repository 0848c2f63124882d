"""How long a campaign with a million finished runs takes to go on, with how much memory and disk.

    python -m tests.campaigns.million_rows [runs]

The rows are those of twenty runs of a minute with other digits in every number; each part has the same rows
under other run numbers, and is compressed alone. The campaign goes on to the point at which it would start
its first missing run. The line printed last is for a tenth of the runs, so that growth is seen.
"""

from __future__ import annotations

import copy
import json
import os
import re
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

import bench
from bench.experiments.campaigns import parts
from bench.experiments.campaigns.journal import NAME
from bench.experiments.campaigns.plan import plan_runs
from bench.experiments.campaigns.pools import SerialExecutor
from bench.experiments.campaigns.worker import (
    RunTask,
    choose_step,
    decode,
    encode,
    fly,
    measure,
    shorten_numbers,
)
from bench.io import results
from bench.io.results import row_parts
from tests.campaigns.test_campaign import PROFILE

MINUTE = PROFILE.replace("duration_s = 20.0", "duration_s = 60.0").replace("from_s = 5.0", "from_s = 15.0")
_SOME = 20


class Resumed(BaseException):
    """The campaign has found what is missing."""


def write_journal(folder: Path, runs: int) -> int:
    """Write a campaign folder with all but the last run of a million; return the bytes of its journal."""
    (folder / "minute.toml").write_text(MINUTE)
    plan = plan_runs(str(folder / "minute.toml"), runs, estimators=["loose-15"])
    (cell,) = plan.cells
    step = choose_step(fly(cell.profile), cell.profile.answer_rate, many=True)
    some = [measure(RunTask("", cell.truth_key, cell.profile, k, step, many=True)) for k in range(_SOME)]
    rng = np.random.default_rng(1)
    rows = [_vary(copy.deepcopy(some[k % _SOME]), f"{cell.key}-{k}", rng) for k in range(parts.ROWS)]
    out = folder / "out"
    with results.keep_folder(out, [NAME, "runs.parquet"], results.CAMPAIGN):
        pass
    first = out / "journal-00001.parquet"
    row_parts.write_part(first, rows)
    table = pq.read_table(first)
    size = first.stat().st_size
    for k in range(runs // parts.ROWS):
        last = k == runs // parts.ROWS - 1
        numbers = pa.array(np.arange(k * parts.ROWS, (k + 1) * parts.ROWS))
        moved = table.set_column(1, table.schema.field(1), numbers)
        path = out / f"journal-{k + 1:05d}.parquet"
        row_parts.write_table(path, moved.slice(0, parts.ROWS - 1) if last else moved)
    assert abs(path.stat().st_size - size) < 0.1 * size
    mark = out / ".bench.json"
    named = json.loads(mark.read_text())
    named["files"] += parts.list_parts(out)
    mark.write_text(json.dumps(named))
    return sum((out / name).stat().st_size for name in parts.list_parts(out))


def _vary(row: dict[str, Any], key: str, rng: np.random.Generator) -> dict[str, Any]:
    """Return a row whose numbers have other digits."""
    row = row | {"key": key}
    row.pop("printed")
    for one in row["estimators"].values():
        one["metrics"] = {
            name: value * float(rng.uniform(0.9, 1.1)) if isinstance(value, float) else value
            for name, value in one["metrics"].items()
        }
        one["metrics"]["answers"] = rng.bytes(8).hex()
        instants = decode(one["instants"])
        one["instants"] = encode(shorten_numbers(instants * rng.uniform(0.9, 1.1, instants.shape)))
    return row


def resume(folder: Path, runs: int) -> None:
    """Go on with the campaign to its first missing run, and print seconds of CPU, and MB at most."""

    def stop(progress: Any) -> None:
        assert (progress.done, progress.total) == (runs - 1, runs)
        raise Resumed

    before = read_memory()
    begun, wall = time.process_time(), time.perf_counter()
    try:
        bench.campaign(
            str(folder / "minute.toml"), runs, estimators=["loose-15"], executor=SerialExecutor(),
            out=folder / "out", resume=True, progress=stop,
        )  # fmt: skip
    except Resumed:
        seconds, wall = time.process_time() - begun, time.perf_counter() - wall
        found = {
            "runs": runs,
            "cpu_s": seconds,
            "wall_s": wall,
            "MB": read_memory(),
            "more_MB": read_memory() - before,
        }
        print(json.dumps(found))


def read_memory() -> float:
    """Return the most memory that this process had [MB]; unlike ``ru_maxrss`` nothing of its parent."""
    (most,) = re.findall(r"^VmHWM:\s+(\d+) kB", Path("/proc/self/status").read_text(), re.MULTILINE)
    return int(most) / 1e3


def main(runs: int) -> list[dict[str, float]]:
    """Print and return a row for the runs, and one for a tenth of them."""
    found = []
    for count in (runs, runs // 10):
        with tempfile.TemporaryDirectory() as place:
            size = write_journal(Path(place), count)
            words = [sys.executable, "-m", "tests.campaigns.million_rows", place, str(count)]
            done = subprocess.run(words, check=True, capture_output=True, text=True, env=os.environ)
            found.append(json.loads(done.stdout) | {"bytes_a_run": size / count})
            print(found[-1], flush=True)
    return found


if __name__ == "__main__":
    if len(sys.argv) == 3:
        resume(Path(sys.argv[1]), int(sys.argv[2]))
    else:
        main(int(sys.argv[1]) if len(sys.argv) > 1 else 1_000_000)
