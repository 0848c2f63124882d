"""The workers of a Dask scheduler; the only module that imports dask."""

from __future__ import annotations

import contextlib
import platform
import sys
import tempfile
import time
import zipfile
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import CancelledError, Future
from pathlib import Path
from typing import Any

from bench.core.records.specs import EstimatorChoice
from bench.core.words.exceptions import ConfigError, WorkersLostError
from bench.core.words.wording import one_line
from bench.experiments.campaigns.plan import describe_software, find_module_files
from bench.io import results

CONNECT_TIME = 20.0  # longest time to reach the scheduler [s]
_PATIENCE = 120.0  # longest time without any worker [s]
_KEPT = "what is finished is kept, --resume continues"


class ClusterPool:
    """The workers of a Dask scheduler; leaving the context cancels pending calls.

    A task whose worker ended is tried by the scheduler on others, and then by the engine alone, so that those
    that were only beside it are not blamed.

    Parameters
    ----------
    address : str
        Of the scheduler, such as ``tcp://10.0.0.1:8786``.
    estimators : sequence of EstimatorChoice
        Their modules are sent to the workers, which leave the import to the processes of the filters.

    Raises
    ------
    ConfigError
        If dask is not installed, the scheduler cannot be reached, or the software of a worker differs.
    """

    remote = True

    def __init__(self, address: str, estimators: Sequence[EstimatorChoice] = ()) -> None:
        try:
            import distributed
        except ImportError:
            raise ConfigError("--scheduler needs dask: pip install dask distributed") from None
        from distributed.comm.core import CommClosedError

        self.lost: tuple[type[BaseException], ...] = (distributed.KilledWorker, CancelledError)
        self._address, self._gone = address, (CommClosedError, RuntimeError, TimeoutError)
        try:
            self._client: Any = distributed.Client(address, timeout=CONNECT_TIME, set_as_default=False)
        except (OSError, ValueError) as error:
            raise ConfigError(f"{address}: no Dask scheduler answers: {error}") from None
        try:
            self._software = describe_software()
            self._check_software(address)
            for choice in estimators:
                self._send_module(choice)
        except BaseException:
            self._client.close()
            raise
        self._executor = self._client.get_executor(pure=False, retries=0)
        self._seen = time.monotonic()

    @property
    def workers(self) -> int:
        """Number of threads of all workers."""
        return max(1, self._count_threads())

    def _count_threads(self) -> int:
        with self._reach():
            return int(sum(self._client.nthreads().values()))

    @contextlib.contextmanager
    def _reach(self) -> Iterator[None]:
        """Raise WorkersLostError if the scheduler is gone."""
        try:
            yield
        except Exception as error:
            if not isinstance(error, self._gone) and self._client.status != "closed":
                raise
            raise WorkersLostError(
                f"{self._address}: the Dask scheduler does not respond: {one_line(str(error))}; {_KEPT}"
            ) from None

    def __enter__(self) -> ClusterPool:
        return self

    def __exit__(self, *error: object) -> None:
        self._executor.shutdown(wait=False)
        self._client.close()

    def submit(self, function: Callable[..., Any], *arguments: Any) -> Future[Any]:
        """Begin a call of a function in a worker with the same software as the driver."""
        with self._reach():
            future: Future[Any] = self._executor.submit(call, self._software, function, *arguments)
        return future

    def recover(self) -> tuple[str, bool]:
        """Return how a worker ended; the scheduler continues with the others, unless it has ended itself."""
        self._count_threads()
        return "its workers ended, each time it was tried", False

    def check(self) -> None:
        """Raise WorkersLostError if the scheduler is gone, or has had no worker for minutes."""
        if self._count_threads():
            self._seen = time.monotonic()
        elif time.monotonic() - self._seen > _PATIENCE:
            raise WorkersLostError(f"no worker for {_PATIENCE:g} s; {_KEPT}")

    def share(self, keys: Sequence[str]) -> None:
        """Write truths from the driver's cache into the caches of other machines, once for each machine."""
        for key in keys:
            with self._reach():
                machines = self._client.run(find_truth, key)
            without = {machine: worker for worker, (machine, found) in machines.items() if not found}
            truth = results.read_truth(key) if without else None
            if truth is not None:
                with self._reach():
                    self._client.run(results.write_truth, key, truth, workers=list(without.values()))

    def _check_software(self, address: str) -> None:
        try:
            found = self._client.run(_describe_worker)
        except Exception as error:
            raise ConfigError(f"{address}: a worker cannot import this bench: {error!r}") from None
        if not found:
            raise ConfigError(f"{address}: has no workers")
        wrong = [
            f"{worker}: {name} {theirs.get(name)}, here {own}"
            for worker, theirs in found.items()
            for name, own in self._software.items()
            if theirs.get(name) != own
        ]
        if wrong:
            raise ConfigError(*(f"worker {line}; equal versions are needed" for line in wrong))

    def _send_module(self, choice: EstimatorChoice) -> None:
        files = find_module_files(choice.use)
        if len(files) == 1 and files[0].name != "__init__.py":
            self._client.upload_file(str(files[0]), load=False)
        elif files:
            root = files[0].parent
            with tempfile.TemporaryDirectory() as folder:
                packed = Path(folder) / f"{root.name}.zip"
                with zipfile.ZipFile(packed, "w") as archive:
                    for file in files:
                        archive.write(file, Path(root.name) / file.relative_to(root))
                self._client.upload_file(str(packed), load=False)


def _describe_worker() -> dict[str, str]:
    return describe_software()


def call(software: dict[str, str], function: Callable[..., Any], *arguments: Any) -> Any:
    """Call a function in a worker, and check its software, because it may have joined late."""
    if _describe_worker() != software:
        raise ConfigError(f"worker on {platform.node()}: its versions differ from the driver")
    _find_packages()
    return function(*arguments)


def _find_packages() -> None:
    """Add the packages that were sent to this worker to its import path, which already has the modules."""
    from distributed import get_worker

    for packed in sorted(Path(get_worker().local_directory).glob("*.zip")):
        if str(packed) not in sys.path:
            sys.path.append(str(packed))


def find_truth(key: str) -> tuple[str, bool]:
    """Return the machine of a worker and whether a truth is in its cache."""
    return platform.node(), results.read_truth(key) is not None
