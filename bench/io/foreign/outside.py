"""Run an external program as a filter: ``use = "command:./myfilter {sensors} {solution}"``.

The program, in any language, runs in a temporary folder with the sensor data as ``bench export --to csv``
writes it, without the truth. It writes a solution that `bench.io.foreign.solutions` reads; each row counts
until the next one, its position moved by its velocity. No shell is used. If the program fails, the result
says why.
"""

from __future__ import annotations

import contextlib
import os
import shlex
import shutil
import stat
import string
import subprocess
import threading
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import IO

import numpy as np

from bench.core.files.scratch import make_scratch
from bench.core.files.spawned import (
    LOOK,
    PATIENCE,
    Printed,
    Watch,
    describe_end,
    describe_output,
    end_group,
    find_last_line,
)
from bench.core.records.data import EventRow, Events, InitialState, NavSolution, SensorData
from bench.core.records.specs import DEFAULT_GUARD, EstimatorChoice, Guard
from bench.core.words.exceptions import ConfigError, EstimatorError
from bench.evaluation.errors.failures import make_failed_solution
from bench.evaluation.errors.resampling import carry_rows
from bench.io.foreign.solution_folder import FolderEstimator, write_sensor_tables
from bench.io.foreign.solutions import FileEstimator, check_unit, read_solution
from bench.navigation.estimator import Estimator, construct

PROGRAM, STDERR = "program", "stderr"
"""Kinds of events: how the program ended; the end of what it wrote to stderr."""

FILE, COMMAND = "file:", "command:"
"""Prefixes of ``use`` for a solution in a file and for a program."""

_FIELDS = ("sensors", "solution", "here")
_MOST_STDERR = 4000  # last part of stderr that is kept [byte]


def load(choice: EstimatorChoice) -> Estimator:
    """Build a filter from ``file:solution.csv`` or ``command:./filter {sensors} {solution}``.

    ``file:`` may also name a folder of solutions (`bench.io.foreign.solution_folder`).

    Raises
    ------
    EstimatorError, ConfigError
        If there is no such file or program, or an option is wrong.
    """
    if choice.use.startswith(FILE):
        path = choice.beside / choice.use.removeprefix(FILE)
        if path.is_dir():
            return construct(choice.label, partial(FolderEstimator, path), choice.options)
        return construct(choice.label, partial(FileEstimator, path), choice.options)
    command = choice.use.removeprefix(COMMAND)
    factory = partial(CommandEstimator, command, choice.beside, choice.guard)
    return construct(choice.label, factory, choice.options)


class CommandEstimator:
    """A filter that runs a program.

    Parameters
    ----------
    command : str
        Program and arguments, quoted as in a shell. ``{sensors}``, the folder with the tables, and
        ``{solution}``, the file to write, are required; ``{here}`` is ``beside``.
    beside : Path
        Folder from which a relative path of the program is taken.
    guard : Guard
        What it may take.
    max_gap_s : float or None
        Longest time that a row is carried on [s], as in `bench.io.foreign.solutions.carry_rows`.

    Raises
    ------
    EstimatorError
        If there is no such program, the command is incomplete, or an option is wrong.
    """

    def __init__(
        self, command: str, beside: Path, guard: Guard = DEFAULT_GUARD, *, max_gap_s: float | None = None
    ) -> None:
        number = isinstance(max_gap_s, int | float) and not isinstance(max_gap_s, bool)
        if max_gap_s is not None and not (number and 0 < max_gap_s < np.inf):
            raise EstimatorError(f"max_gap_s = {max_gap_s!r} must be a number above 0 [s]")
        self._guard, self._longest = guard, max_gap_s
        self._arguments = _split_command(command)
        self._beside = beside.resolve()
        self._arguments[0] = _find_program(self._arguments[0], self._beside)

    def run(self, sensors: SensorData, initial: InitialState) -> NavSolution:
        """Run the program; return its solution at ``sensors.output_t``, or NaN and an event "failed"."""
        with make_scratch() as scratch:
            place = scratch / "program"  # it sees this folder and not the lock beside it
            place.mkdir()
            folder = place / "sensors"
            folder.mkdir()
            write_sensor_tables(folder, sensors, initial)
            solution = place / "solution.csv"
            fields = {"sensors": str(folder), "solution": str(solution), "here": str(self._beside)}
            arguments = [argument.format_map(fields) for argument in self._arguments]
            seconds = self._guard.choose_timeout(sensors.duration_from(initial.t))
            ended, stderr, status = self._run_program(arguments, place, solution, seconds)
            events: list[EventRow] = [(0.0, 0.0, PROGRAM, ended)]
            if stderr:
                events.append((0.0, 0.0, STDERR, stderr))
            if status != 0:
                why = ": ".join(filter(None, [ended, find_last_line(stderr)]))
                return make_failed_solution(sensors.output_t, why, events)
            try:
                own_solution = read_solution(solution)
                check_unit(own_solution, initial.t, initial.lla)
            except ConfigError as error:
                return make_failed_solution(sensors.output_t, f"{ended}: {error}", events)
            result = carry_rows(own_solution, sensors.output_t, self._longest)
        return replace(result, events=Events.from_rows([*result.events.rows(), *events]))

    def _run_program(
        self, arguments: list[str], cwd: Path, solution: Path, seconds: float
    ) -> tuple[str, str, int]:
        """Run the program until its end or a limit; return how it ended, its last stderr, its status."""
        (cwd / "home").mkdir()
        environment = {
            "PATH": os.environ.get("PATH", os.defpath),
            "HOME": str(cwd / "home"),
            "TMPDIR": str(cwd / "home"),
            "LC_ALL": "C",
            **{key: os.environ[key] for key in ("SYSTEMROOT", "LD_LIBRARY_PATH") if key in os.environ},
        }
        try:
            child = subprocess.Popen(
                arguments,
                cwd=cwd,
                env=environment,
                stdin=subprocess.DEVNULL,
                stdout=subprocess.DEVNULL,
                stderr=subprocess.PIPE,
                start_new_session=True,
                close_fds=True,
            )
        except OSError as error:
            return f"the program could not be started: {error.strerror or error}", "", -1
        tail = _Tail(child.stderr)
        stopped = ""
        try:
            watch = Watch(child.pid, seconds, self._guard.choose_memory())
            while child.poll() is None and not stopped:
                with contextlib.suppress(subprocess.TimeoutExpired):
                    child.wait(LOOK)
                stopped = watch.look()
                if _measure_size(solution) > self._guard.output:
                    stopped = describe_output(self._guard.output)
        finally:
            end_group(child)
        stderr = tail.read()
        if stopped:
            return stopped, stderr, -1
        status = child.returncode
        return describe_end(status) if status < 0 else f"exit status {status}", stderr, status


class _Tail:
    """The last part of a stream, read in a thread: the writer never waits and memory is bounded."""

    def __init__(self, stream: IO[bytes] | None) -> None:
        assert stream is not None  # it is a pipe
        self._stream, self._kept = stream, Printed(0, _MOST_STDERR)
        self._thread = threading.Thread(target=self._read, daemon=True)
        self._thread.start()

    def _read(self) -> None:
        while block := os.read(self._stream.fileno(), 1 << 16):
            self._kept.add(block)

    def read(self) -> str:
        """Wait for the end of the stream; return its last part without control characters."""
        self._thread.join(PATIENCE)
        if not self._thread.is_alive():
            self._stream.close()
        return "".join(c for c in self._kept.text if c == "\n" or c.isprintable())


def _split_command(command: str) -> list[str]:
    try:
        arguments = shlex.split(command)
        names = [name for argument in arguments for _, name, _, _ in string.Formatter().parse(argument)]
    except ValueError as error:
        raise EstimatorError(f"command {command!r}: {error}") from None
    used = [name for name in names if name is not None]
    unknown = sorted(set(used) - set(_FIELDS))
    if unknown:
        known = ", ".join(f"{{{name}}}" for name in _FIELDS)
        raise EstimatorError(f"command {command!r}: {{{unknown[0]}}} is not one of {known}")
    missing = [name for name in ("sensors", "solution") if name not in used]
    if missing:
        example = "'./myfilter {sensors} {solution}'"
        raise EstimatorError(f"command {command!r}: {{{missing[0]}}} is missing; for example {example}")
    return arguments


def _find_program(name: str, beside: Path) -> str:
    """Return the path of a program: from ``beside`` if the name has a slash, else from the PATH."""
    if "{" in name.replace("{here}", ""):
        raise EstimatorError(f"command: the program is {name!r}; it must not come from a field")
    name = name.replace("{here}", str(beside))
    if "/" not in name and os.sep not in name:
        found = shutil.which(name)
        if found is None:
            raise EstimatorError(
                f"command: no program {name!r} on the PATH; one in this folder is './{name}'"
            )
        return found.replace("{", "{{").replace("}", "}}")
    path = (beside / name).absolute()
    if not path.is_file() or not os.access(path, os.X_OK):
        what = "no such file" if not path.exists() else "not a program that can be run"
        raise EstimatorError(f"command: {path}: {what}")
    return str(path).replace("{", "{{").replace("}", "}}")


def _measure_size(path: Path) -> int:
    try:
        found = path.lstat()
    except OSError:
        return 0
    return found.st_size if stat.S_ISREG(found.st_mode) else 0
