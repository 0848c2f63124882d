"""The engine survives the workers that end. The functions need no numpy, so that workers start at once."""

from __future__ import annotations

import os
import select
import signal
import subprocess
import sys
import time
from concurrent.futures import Future
from typing import Any

import pytest

from bench.experiments.campaigns.batches import BATCH, Lost, Pace, compute
from bench.experiments.campaigns.pools import THREADS, ProcessPool


def square(x: int) -> int:
    return x * x


def end_at(item: tuple[int, str]) -> int:
    """End the worker, if the item says how."""
    number, how = item
    if how == "exit":
        os._exit(3)
    if how == "kill":
        os.kill(os.getpid(), signal.SIGKILL)
    if how.startswith("once ") and not os.path.exists(how[5:]):
        open(how[5:], "x").close()
        os._exit(1)
    return number


def describe_worker(item: None) -> tuple[Any, ...]:
    blocked = signal.pthread_sigmask(signal.SIG_BLOCK, [])
    return [os.environ[name] for name in THREADS], signal.SIGINT in blocked


def test_every_item_has_its_result():
    with ProcessPool(2) as pool:
        assert dict(compute(square, range(9), pool, first=[4])) == {k: k * k for k in range(9)}


def test_what_ends_its_worker_is_given_up_with_the_reason_and_all_others_finish(tmp_path):
    items = [(k, {3: "exit", 7: "kill", 5: f"once {tmp_path / 'mark'}"}.get(k, "")) for k in range(10)]
    with ProcessPool(2) as pool:
        found = dict(compute(end_at, items, pool))
    assert found.pop(3) == Lost("its worker process ended with exit status 3")
    assert found.pop(7) == Lost("its worker process was ended by SIGKILL")
    assert found == {k: k for k in range(10) if k not in (3, 7)}


def test_a_worker_has_one_thread_and_does_not_hear_an_interruption():
    before = {name: os.environ.get(name) for name in THREADS}
    with ProcessPool(1) as pool:
        [(_, found)] = compute(describe_worker, [None], pool)
    assert found == (["1"] * len(THREADS), True)
    assert {name: os.environ.get(name) for name in THREADS} == before
    assert signal.SIGINT not in signal.pthread_sigmask(signal.SIG_BLOCK, [])


def interrupt() -> None:
    with ProcessPool(1) as pool:
        pool.submit(time.sleep, 60.0)
        raise KeyboardInterrupt


def test_what_runs_is_finished_at_the_end_and_ended_by_an_error():
    with ProcessPool(1) as pool:
        finished = pool.submit(square, 3)
    assert finished.result(0.0) == 9
    begun = time.monotonic()
    with pytest.raises(KeyboardInterrupt):
        interrupt()
    assert time.monotonic() - begun < 50.0


DRIVER = """
import time
from bench.experiments.campaigns.batches import compute
from bench.experiments.campaigns.pools import ProcessPool
from tests.campaigns.test_batches import tell
with ProcessPool(2) as pool:
    for _ in compute(tell, [0, 1], pool):
        pass
"""


def tell(item: int) -> None:
    os.write(1, f"{os.getpid()}\n".encode())
    time.sleep(600)


def test_workers_end_with_a_driver_that_was_killed():
    with subprocess.Popen([sys.executable, "-c", DRIVER], stdout=subprocess.PIPE, text=True) as driver:
        assert driver.stdout is not None
        workers = [int(driver.stdout.readline()) for _ in range(2)]
        driver.kill()
        ready, _, _ = select.select([driver.stdout], [], [], 30.0)  # no worker holds it
        for pid in () if ready else workers:
            os.kill(pid, signal.SIGKILL)
    assert ready


class Recorder:
    """A pool that keeps the sizes of batches and needs a second for each item."""

    workers, lost, remote = 2, (), False

    def __init__(self) -> None:
        self.sizes: list[int] = []

    def submit(self, function: Any, *arguments: Any) -> Future[Any]:
        future: Future[Any] = Future()
        self.sizes.append(len(arguments[1]))
        future.set_result([(None, 0.5) for _ in arguments[1]])
        return future

    def recover(self) -> tuple[str, bool]:
        raise AssertionError


def test_batches_last_a_few_seconds_and_the_last_ones_are_small():
    pool = Recorder()
    assert len(list(compute(square, range(100), pool))) == 100
    assert max(pool.sizes) == BATCH / 0.5
    assert pool.sizes[:4] == [1, 1, 1, 1]
    assert pool.sizes[-1] == 1
    assert Pace().choose_size(100, 2) == 1


STOPPED_WHILE_IT_BEGINS = """
import os, signal, sys
from bench.experiments.campaigns import pools

class Thread:
    def __init__(self, **options): pass
    def start(self): os.kill(os.getpid(), signal.SIGTERM)

pools.threading.Thread = Thread
pools.prepare_worker(sys.path)
"""


def test_a_worker_that_is_stopped_while_it_begins_says_nothing():
    """The executor would print an exception there, before the line of the error that ends the work."""
    done = subprocess.run([sys.executable, "-c", STOPPED_WHILE_IT_BEGINS], capture_output=True, timeout=60)
    assert (done.returncode, done.stderr) == (-signal.SIGTERM, b"")
