"""Apply a function to many items on the workers of a pool, also if an item crashes its worker.

Items travel in batches of a few seconds. If a worker ends, nobody knows which of the items under way ended
it. So the batches that were under way run once more, each alone; the one that ends its worker again is
divided, and an item that ends its worker `ATTEMPTS` times while it runs alone is given up. All others finish.
"""

from __future__ import annotations

import time
from collections import Counter, deque
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, wait
from dataclasses import dataclass
from typing import Any, Protocol, TypeVar

Item = TypeVar("Item")
Result = TypeVar("Result")

BATCH = 4.0
"""Duration of a batch that is aimed at [s]."""

ATTEMPTS = 2
"""How often an item may end its worker while it runs alone."""

LOOK = 10.0  # between looks at the pool while nothing finishes [s]
_AHEAD = 2  # batches given to each worker, so that it never waits for the next one


@dataclass(frozen=True, slots=True)
class Lost:
    """Placeholder for the result of an item that crashed its worker each time."""

    reason: str


class Pool(Protocol):
    """Workers that apply functions; see `bench.experiments.campaigns.pools`."""

    @property
    def workers(self) -> int:
        """Number of calls that run at the same time."""

    remote: bool  # the workers may be on other machines
    lost: tuple[type[BaseException], ...]  # what a future raises if its worker ended

    def submit(self, function: Callable[..., Any], *arguments: Any) -> Future[Any]:
        """Begin a call of a function in a worker."""

    def check(self) -> None:
        """Raise an error if no call can finish any more."""

    def share(self, keys: Sequence[str]) -> None:
        """Let the workers find flown truths in the cache of their machine."""

    def recover(self) -> tuple[str, bool]:
        """Replace a broken pool; return how the worker ended, and whether all futures failed."""


def compute(
    function: Callable[[Item], Result], items: Sequence[Item], pool: Pool, first: Sequence[int] = ()
) -> Iterator[tuple[int, Result | Lost]]:
    """Yield the number and the result of every item, in the order in which they finish.

    Parameters
    ----------
    function : callable
        Importable by the workers. What it raises ends the work.
    items : sequence
        Each goes through pickle. Neighbors share a batch.
    pool : Pool
        The workers.
    first : sequence of int
        Items that run before the others, one at a time: they compile what the others load.
    """
    waiting = deque(k for k in range(len(items)) if k not in set(first))
    alone = deque([k] for k in first)  # batches that run while nothing else does
    running: dict[Future[list[tuple[Result, float]]], list[int]] = {}
    attempts, pace = Counter[int](), Pace()

    def start(numbers: list[int]) -> None:
        running[pool.submit(apply, function, [items[k] for k in numbers])] = numbers

    only = False  # what runs is alone
    while waiting or alone or running:
        if alone:
            if not running:
                only = True
                start(alone.popleft())
        elif not only or not running:
            only = False
            while waiting and len(running) < _AHEAD * pool.workers:
                size = pace.choose_size(len(waiting), pool.workers)
                start([waiting.popleft() for _ in range(size)])
        done, _ = wait(running, LOOK, FIRST_COMPLETED)
        if not done:
            pool.check()
        lost: list[list[int]] = []
        reason = ""
        while done:
            for future in done:
                numbers = running.pop(future)
                try:
                    results = future.result()
                except pool.lost:
                    lost.append(numbers)
                    continue
                for k, (value, seconds) in zip(numbers, results, strict=True):
                    pace.add(seconds)
                    yield k, value
            done = set()
            if lost and not reason:
                reason, everything = pool.recover()
                done = wait(running).done if everything else done
        for numbers in sorted(lost):
            if not only:
                alone.append(numbers)
            elif len(numbers) > 1:
                alone.extend([k] for k in numbers)
            else:
                attempts.update(numbers)
                if attempts[numbers[0]] < ATTEMPTS:
                    alone.append(numbers)
                else:
                    yield numbers[0], Lost(reason)


class Pace:
    """The size of the next batch, from the durations of finished items."""

    def __init__(self) -> None:
        self._items, self._seconds = 0, 0.0

    def add(self, seconds: float) -> None:
        """Add the duration of an item [s]."""
        self._items += 1
        self._seconds += seconds

    def choose_size(self, waiting: int, workers: int) -> int:
        """Return the number of waiting items in the next batch."""
        if not self._seconds:
            return 1
        fits = int(BATCH * self._items / self._seconds)
        fair = -(-waiting // (_AHEAD * workers))  # the last batches end together
        return max(1, min(fits, fair))


def apply(function: Callable[[Item], Result], items: Sequence[Item]) -> list[tuple[Result, float]]:
    """Return the results of a batch, each with its duration [s]; runs in a worker."""
    results = []
    for item in items:
        begun = time.perf_counter()
        results.append((function(item), time.perf_counter() - begun))
    return results
