"""What pytest is told while mutants are made: by whom code is executed, and which tests are to run.

Coverage writes down for each line the contexts in which it was executed: a test, or a fixture of wider scope,
which only the first of its tests makes. Processes that a test starts inherit its context.
"""

from __future__ import annotations

import json
import os
from collections.abc import Generator, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import coverage
import pytest

CONTEXT = "MUTANTS_CONTEXT"
"""Environment variable with the context of new processes."""

REPORTED = "MUTANTS_REPORTED"
"""Environment variable with the file to write: seconds, outcome and fixtures of each test."""

CHOSEN = "MUTANTS_CHOSEN"
"""Environment variable with a file that lists the tests to run, in their order."""

SHARED = "fixture "
"""What the context of a fixture begins with that more than one test uses."""

_reported: dict[str, dict[str, Any]] = {}


def _enter(context: str) -> str:
    """Enter a context and return the one before."""
    before = os.environ.get(CONTEXT, "")
    os.environ[CONTEXT] = context
    measuring = coverage.Coverage.current()
    if measuring is not None:
        measuring.switch_context(context)
    return before


@contextmanager
def _entered(context: str) -> Iterator[None]:
    before = _enter(context)
    try:
        yield
    finally:
        _enter(before)


@pytest.hookimpl(wrapper=True, tryfirst=True)
def pytest_runtest_protocol(item: pytest.Item) -> Generator[None, object, object]:
    """Enter the context of a test."""
    item.user_properties.append(("fixtures", list(getattr(item, "fixturenames", ()))))
    with _entered(item.nodeid):
        return (yield)


@pytest.hookimpl(wrapper=True, tryfirst=True)
def pytest_fixture_setup(
    fixturedef: pytest.FixtureDef[Any], request: pytest.FixtureRequest
) -> Generator[None, object, object]:
    """Enter the context of a fixture that more than one test uses: where it holds, and its name."""
    if fixturedef.scope == "function":
        return (yield)
    where = "" if isinstance(request.node, pytest.Session) else request.node.nodeid
    with _entered(f"{SHARED}{where}>{fixturedef.argname}"):
        return (yield)


def pytest_runtest_logreport(report: pytest.TestReport) -> None:
    """Remember how a test went."""
    one = _reported.setdefault(report.nodeid, {"seconds": 0.0, "passed": False, "fixtures": []})
    one["seconds"] += report.duration
    one["fixtures"] = dict(report.user_properties).get("fixtures", [])
    if report.when == "call":
        one["passed"] = report.passed


def pytest_sessionfinish() -> None:
    """Write how the tests went."""
    if REPORTED in os.environ and "PYTEST_XDIST_WORKER" not in os.environ:
        Path(os.environ[REPORTED]).write_text(json.dumps(_reported), encoding="utf-8")


@pytest.hookimpl(trylast=True)
def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Keep the chosen tests, in their order."""
    if CHOSEN in os.environ:
        chosen = json.loads(Path(os.environ[CHOSEN]).read_text(encoding="utf-8"))
        rank = {nodeid: k for k, nodeid in enumerate(chosen)}
        items[:] = sorted((one for one in items if one.nodeid in rank), key=lambda one: rank[one.nodeid])
