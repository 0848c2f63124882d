"""A filter that is a program of its own: ``use = "command:./myfilter {sensors} {solution}"``.

The program, in any language, runs in a temporary folder that holds the sensors as ``bench export --to csv``
writes them, and nothing of the truth; it writes its solution as `bench.exchange.solutions` reads it. No shell
is between. A program that fails is a result that says why.
"""

from __future__ import annotations

import contextlib
import os
import shlex
import shutil
import signal
import stat
import string
import subprocess
import tempfile
import threading
import time
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import IO

import numpy as np

from bench.arrays import FloatArray
from bench.data import Events, InitialState, NavSolution, SensorData, no_innovations
from bench.errors import ConfigError, EstimatorError
from bench.evaluation.error_series import FAILED
from bench.exchange.exports.column_files import write as write_tables
from bench.exchange.exports.outgoing import ExportData
from bench.exchange.solutions import FileEstimator, check_unit, read_solution, resample
from bench.navigation.estimator import Estimator, construct
from bench.specs import EstimatorChoice
from bench.store import make_start_document

TIMEOUT = 600.0
"""How long a program may take unless told otherwise [s]."""

PROGRAM, STDERR = "program", "stderr"
"""Kinds of events: how the program ended; the end of what it wrote to stderr."""

FILE, COMMAND = "file:", "command:"
"""How the ``use`` of a solution in a file, and of a program, begins."""

_FIELDS = ("sensors", "solution", "here")
_MOST_STDERR = 4000  # what is kept of it, from its end [byte]
_MOST_WRITTEN = 2_000_000_000  # the program is stopped when its solution grows beyond [byte]
_LOOK = 0.05  # between looks at the program [s]
_PATIENCE = 2.0  # between asking it to end and ending it [s]


def load(choice: EstimatorChoice) -> Estimator:
    """Build what stands for an estimator: ``file:solution.csv``, ``command:./filter {sensors} {solution}``.

    Raises
    ------
    EstimatorError, ConfigError
        If there is no such file or program, or an option is wrong: one line.
    """
    if choice.use.startswith(FILE):
        path = choice.beside / choice.use.removeprefix(FILE)
        return construct(choice.label, partial(FileEstimator, path), choice.options)
    command = choice.use.removeprefix(COMMAND)
    return construct(choice.label, partial(CommandEstimator, command, choice.beside), choice.options)


class CommandEstimator:
    """A program in the place of an estimator.

    Parameters
    ----------
    command : str
        Program and arguments, as in a shell but without one. ``{sensors}`` is the folder with the tables,
        ``{solution}`` the file to write, both have to be there; ``{here}`` is ``beside``.
    beside : Path
        Where a program given with a relative path is.
    timeout_s : float
        How long it may take.
    max_gap_s : float or None
        As `bench.exchange.solutions.resample` takes it.

    Raises
    ------
    EstimatorError
        If there is no such program or the command is not complete.
    """

    def __init__(
        self, command: str, beside: Path, *, timeout_s: float = TIMEOUT, max_gap_s: float | None = None
    ) -> None:
        asked = {"timeout_s": timeout_s, "max_gap_s": 1.0 if max_gap_s is None else max_gap_s}
        for name, value in asked.items():
            if not isinstance(value, int | float) or isinstance(value, bool) or not 0 < value < np.inf:
                raise EstimatorError(f"{name} = {value!r} must be a number above 0 [s]")
        self._timeout, self._longest = float(timeout_s), max_gap_s
        self._arguments = _split_command(command)
        self._beside = beside.resolve()
        self._arguments[0] = _find_program(self._arguments[0], self._beside)

    def run(self, sensors: SensorData, initial: InitialState) -> NavSolution:
        """Return what the program says at ``sensors.output_t``; NaN and an event "failed" when it fails."""
        with tempfile.TemporaryDirectory(prefix="bench-outside-", ignore_cleanup_errors=True) as scratch:
            folder = Path(scratch) / "sensors"
            folder.mkdir()
            document = make_start_document(sensors, initial)
            out = ExportData(sensors.imu, sensors.fixes, sensors.observations, sensors.instruments, document)
            write_tables(folder, out, "csv")
            np.savetxt(folder / "output.csv", sensors.output_t, fmt="%.9f", header="t_s", comments="")
            solution = Path(scratch) / "solution.csv"
            told = {"sensors": str(folder), "solution": str(solution), "here": str(self._beside)}
            arguments = [argument.format_map(told) for argument in self._arguments]
            ended, stderr, status = self._watched(arguments, Path(scratch), solution)
            events = [(0.0, 0.0, PROGRAM, ended), *([(0.0, 0.0, STDERR, stderr)] if stderr else [])]
            if status != 0:
                last = stderr.strip().splitlines()[-1:]
                return _make_failed_solution(sensors.output_t, ": ".join([ended, *last]), events)
            try:
                given = read_solution(solution)
                check_unit(given, initial.t, initial.lla)
            except ConfigError as error:
                return _make_failed_solution(sensors.output_t, f"{ended}: {error}", events)
            found = resample(given, sensors.output_t, self._longest)
        rows = [*zip(found.events.t, found.events.t_end, found.events.kind, found.events.text, strict=True)]
        return _replace_events(found, [*rows, *events])

    def _watched(self, arguments: list[str], cwd: Path, solution: Path) -> tuple[str, str, int]:
        """Run the program to its end or to its limit; return how it ended, the end of stderr, its status."""
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
            end = time.monotonic() + self._timeout
            while child.poll() is None and not stopped:
                with contextlib.suppress(subprocess.TimeoutExpired):
                    child.wait(_LOOK)
                if time.monotonic() > end:
                    stopped = f"stopped after {self._timeout:g} s (timeout_s)"
                elif _measure_size(solution) > _MOST_WRITTEN:
                    stopped = f"stopped: its solution is larger than {_MOST_WRITTEN // 1_000_000} MB"
        finally:
            _end_group(child)
        said = tail.text()
        if stopped:
            return stopped, said, -1
        status = child.returncode
        if status < 0:
            return f"ended by signal {signal.Signals(-status).name}", said, status
        return f"exit status {status}", said, status


class _Tail:
    """The end of what a stream says, read as it comes: the writer never waits, memory is bounded."""

    def __init__(self, stream: IO[bytes] | None) -> None:
        assert stream is not None  # it is a pipe
        self._stream, self._kept = stream, b""
        self._thread = threading.Thread(target=self._read, daemon=True)
        self._thread.start()

    def _read(self) -> None:
        while block := os.read(self._stream.fileno(), 1 << 16):
            self._kept = (self._kept + block)[-_MOST_STDERR:]

    def text(self) -> str:
        """Return it, without what a terminal would obey."""
        self._thread.join(_PATIENCE)
        text = self._kept.decode("utf-8", errors="replace")
        if not self._thread.is_alive():
            self._stream.close()
        return "".join(c for c in text if c == "\n" or c.isprintable())


def _split_command(command: str) -> list[str]:
    try:
        arguments = shlex.split(command)
        names = [name for argument in arguments for _, name, _, _ in string.Formatter().parse(argument)]
    except ValueError as error:
        raise EstimatorError(f"command {command!r}: {error}") from None
    asked = [name for name in names if name is not None]
    unknown = sorted(set(asked) - set(_FIELDS))
    if unknown:
        known = ", ".join(f"{{{name}}}" for name in _FIELDS)
        raise EstimatorError(f"command {command!r}: {{{unknown[0]}}} is none of {known}")
    missing = [name for name in ("sensors", "solution") if name not in asked]
    if missing:
        example = "'./myfilter {sensors} {solution}'"
        raise EstimatorError(f"command {command!r}: {{{missing[0]}}} is missing; for example {example}")
    return arguments


def _find_program(name: str, beside: Path) -> str:
    """Return the program a command names: with a slash a path from ``beside``, without one of the PATH."""
    if "{" in name.replace("{here}", ""):
        raise EstimatorError(f"command: the program is {name!r}; it must stand there itself")
    name = name.replace("{here}", str(beside))
    if "/" not in name and os.sep not in name:
        found = shutil.which(name)
        if found is None:
            raise EstimatorError(f"command: no program {name!r} on the PATH; one that is here is './{name}'")
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


def _end_group(child: subprocess.Popen[bytes]) -> None:
    """End what is left of the program's process group, politely first."""
    for number in (signal.SIGTERM, signal.SIGKILL):
        with contextlib.suppress(ProcessLookupError, PermissionError):
            os.killpg(child.pid, number)
        with contextlib.suppress(subprocess.TimeoutExpired):
            child.wait(_PATIENCE)


def _make_failed_solution(
    t: FloatArray, why: str, events: list[tuple[float, float, str, str]]
) -> NavSolution:
    m = len(t)
    return NavSolution(
        t=t,
        lla=np.full((m, 3), np.nan),
        vel_n=np.full((m, 3), np.nan),
        q_nb=np.full((m, 4), np.nan),
        gyro_bias_b=np.full((m, 3), np.nan),
        accel_bias_b=np.full((m, 3), np.nan),
        cov=np.full((m, 9, 9), np.nan),
        extra_names=(),
        extra=np.empty((m, 0)),
        extra_sd=np.empty((m, 0)),
        innovations=no_innovations(),
        events=Events.from_rows([(0.0, 0.0, FAILED, why), *events]),
    )


def _replace_events(solution: NavSolution, rows: list[tuple[float, float, str, str]]) -> NavSolution:
    return replace(solution, events=Events.from_rows(rows))
