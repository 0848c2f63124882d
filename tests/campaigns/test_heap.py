"""The memory that a worker keeps from one run to the next."""

import platform
import subprocess
import sys

import pytest

RUNS = """
import resource
import numpy as np
from bench.experiments.campaigns.heap import keep_freed_memory

def run():
    before = resource.getrusage(resource.RUSAGE_SELF).ru_minflt
    held = [np.ones(400_000) for _ in range(12)]  # each too small for huge pages
    del held
    return resource.getrusage(resource.RUSAGE_SELF).ru_minflt - before

given_back = [run() for _ in range(4)][-1]
assert keep_freed_memory()
kept = [run() for _ in range(4)][-1]
print(given_back, kept)
"""


@pytest.mark.skipif(platform.libc_ver()[0] != "glibc", reason="the allocator of glibc is asked")
def test_the_pages_of_a_run_are_taken_from_the_system_once():
    """38 MB of arrays, taken and freed: without it each run faults its pages in again."""
    done = subprocess.run([sys.executable, "-c", RUNS], capture_output=True, text=True, check=True)
    given_back, kept = map(int, done.stdout.split())
    assert kept < 0.5 * given_back
