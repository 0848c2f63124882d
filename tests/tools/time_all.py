"""What every study costs on its defaults: ``python -m tests.tools.time_all [NAME...]``.

One after the other, each a command as a user types it, with all processors; a line each with its CPU and wall
seconds and its exit status, and the sum. Kernels and flights come from the caches of the machine, so that the
first time is dearer. `logs` needs recordings and is left out. The exit status is 1 if a study failed.
"""

from __future__ import annotations

import os
import resource
import subprocess
import sys
import time

from bench.experiments.campaigns.pools import count_processors
from bench.experiments.studies import STUDIES

ARGUMENTS = {
    "budget": ("figure-eight", "--estimator", "loose-22"),
    "bound": ("figure-eight",),
    "sensitivity": ("figure-eight", "sensors.gnss.latency_s", "--values", "0,0.1,0.5"),
    "closed-loop": ("approach-closed",),
    "rnp": ("waypoints", "--gnss", "sky-l1"),
}
"""What a study must be given, as the guide has it."""

_ANSWERED = (0, 1, 6)  # yes, no, undecided


def time_study(name: str) -> tuple[float, float, int]:
    """Return the CPU and wall times [s] of a study with its workers, and its exit status."""
    command = (sys.executable, "-m", "bench", "study", name, *ARGUMENTS.get(name, ()))
    environment = dict(os.environ)
    environment.pop("PYTHONDONTWRITEBYTECODE", None)  # as it is where bench is installed
    before, begun = resource.getrusage(resource.RUSAGE_CHILDREN), time.monotonic()
    status = subprocess.run(command, env=environment, capture_output=True, check=False).returncode
    wall, after = time.monotonic() - begun, resource.getrusage(resource.RUSAGE_CHILDREN)
    return after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime, wall, status


def main(names: list[str]) -> int:
    """Print the times of studies, of all but `logs` if none is named."""
    found = []
    for name in names or [name for name in STUDIES if name != "logs"]:
        found.append(time_study(name))
        print("{:<15} {:6.1f} s CPU {:6.1f} s wall   exit status {}".format(name, *found[-1]), flush=True)
    cpu, wall = (sum(one[k] for one in found) for k in (0, 1))
    print(f"{'all':<15} {cpu:6.1f} s CPU {wall:6.1f} s wall   on {count_processors()} processors")
    return int(any(status not in _ANSWERED for _, _, status in found))


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
