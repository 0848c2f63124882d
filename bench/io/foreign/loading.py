"""Choice of the process of a filter: this process or a separate one; decided only here."""

from __future__ import annotations

import functools
import sys
from collections.abc import Iterable
from typing import Protocol, Self, runtime_checkable

from bench.core.records.specs import EstimatorChoice
from bench.navigation import built_in
from bench.navigation.built_in import BUILT_IN
from bench.navigation.estimator import Estimator


def load_estimators(choices: Iterable[EstimatorChoice]) -> list[Estimator]:
    """Build filters: built-in ones here, programs and classes of others in processes of their own.

    Raises
    ------
    EstimatorError, ConfigError
        If there is no such filter, file or program, or its options are wrong.
    EstimatorFailedError
        If the module or the constructor of a class raised.
    """
    begun = [_begin(choice) for choice in choices]  # their processes start at the same time
    return [one.wait() if isinstance(one, Awaited) else one for one in begun]


GUARDS_CLASSES = sys.platform != "win32"
"""Whether a class gets a process of its own; Windows lacks the sockets and groups that hold it."""


@functools.cache
def _warn_unguarded() -> None:
    limits = "without --timeout, --memory and --output"
    print(f"bench: on Windows your class runs in the process of bench, {limits}", file=sys.stderr)


@runtime_checkable
class Awaited(Estimator, Protocol):
    """A filter that is being built in its process."""

    def wait(self) -> Self:
        """Wait until the filter is built, and return it."""
        ...


def _begin(choice: EstimatorChoice) -> Estimator:
    if choice.use.startswith(("file:", "command:")):
        from bench.io.foreign import outside

        return outside.load(choice)
    if choice.use in BUILT_IN or choice.guard.in_process or not built_in.is_class(choice.use):
        return built_in.load(choice.use, choice.options)  # what is no name at all is told there
    if not GUARDS_CLASSES:
        _warn_unguarded()
        return built_in.load(choice.use, choice.options)
    from bench.io.foreign.own_process import OwnProcessEstimator

    return OwnProcessEstimator(choice)
