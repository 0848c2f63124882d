"""An interruption at any time ends a run with status 130 and one line, and leaves nothing behind."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import psutil
import pytest

from bench import pipeline
from bench.cli.command_line import main
from bench.core.compilation.compiled import choose_cache
from tests.cli.test_cli import PROFILE

COMMAND = [sys.executable, "-m", "bench", "run", "short.toml"]
START = 0.08  # Python itself has started after this much processor time [s]


def start(folder: Path, kernels: str) -> subprocess.Popen[str]:
    for name in ("cache", "tmp", "here"):
        (folder / name).mkdir(parents=True, exist_ok=True)
    (folder / "here" / "short.toml").write_text(PROFILE)
    env = os.environ | {
        "PYTHONPATH": str(Path(pipeline.__file__).parents[1]),
        "BENCH_CACHE": str(folder / "cache"),
        "NUMBA_CACHE_DIR": kernels,
        "TMPDIR": str(folder / "tmp"),
    }
    return subprocess.Popen(
        COMMAND, cwd=folder / "here", env=env, text=True, stdout=subprocess.PIPE, stderr=subprocess.PIPE
    )


def used(process: subprocess.Popen[str]) -> float:
    """Return the processor time of a process and of its children that have ended [s]."""
    return sum(psutil.Process(process.pid).cpu_times()[:4])


def measure(folder: Path, kernels: str) -> float:
    """Return the processor time of a run until its results are written [s]."""
    process, last = start(folder, kernels), 0.0
    while process.poll() is None and not (folder / "here" / "runs" / "short-5").exists():
        last = max(last, used(process))
        time.sleep(0.005)
    _, err = process.communicate()
    assert process.returncode == 0, err
    return last


def interrupt(folder: Path, kernels: str, after: float) -> list[str]:
    """Interrupt a run after a processor time; return what is wrong with its end."""
    process = start(folder, kernels)
    while process.poll() is None and used(process) < after:
        time.sleep(0.002)
    ended = process.poll() is not None
    process.send_signal(signal.SIGINT)
    _, err = process.communicate(timeout=120)
    if ended:  # a little faster than the one that was measured
        return interrupt(folder / "again", kernels, 0.95 * after)
    wrong = []
    if (process.returncode, err.strip()) != (130, "error: interrupted"):
        wrong.append(f"{after:.2f} s: status {process.returncode}: {err.strip()[-300:]}")
    left = [*(folder / "tmp").iterdir(), *(folder / "cache").glob("truth/.*")]
    left += [path for path in (folder / "here").rglob("*") if path.name.startswith(".bench-")]
    runs = folder / "here" / "runs"
    if runs.exists() and not (runs / "short-5" / ".bench.json").is_file():
        left.append(runs)
    return wrong + [f"{after:.2f} s: left {path}" for path in left]


@pytest.mark.skipif(sys.platform != "linux", reason="elsewhere the time of children is not told")
def test_a_run_is_interrupted_at_three_instants(tmp_path):
    wrong = [
        line
        for k, after in enumerate((START, 0.5, 1.0))
        for line in interrupt(tmp_path / str(k), str(choose_cache().parent), after)
    ]
    assert wrong == []


@pytest.mark.long
@pytest.mark.skipif(sys.platform != "linux", reason="elsewhere the time of children is not told")
def test_a_run_is_interrupted_at_twenty_instants(tmp_path):
    """Imports, flight, filter, writing and recording with compiled kernels; then while they are compiled."""
    warm = str(choose_cache().parent)
    whole = measure(tmp_path / "whole", warm)
    wrong = []
    for k in range(14):
        after = START + (whole - START) * k / 13
        wrong += interrupt(tmp_path / f"warm-{k}", warm, after)
    for k in range(6):
        after = whole * 0.5 + 1.5 * k
        wrong += interrupt(tmp_path / f"cold-{k}", str(tmp_path / f"kernels-{k}"), after)
    assert wrong == []


class _Drops:
    """Interrupted in ``__del__``, where Python drops exceptions."""

    def __del__(self) -> None:
        signal.raise_signal(signal.SIGINT)
        time.sleep(0.001)


def test_an_interruption_that_code_in_between_turns_into_something_else(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("BENCH_CACHE", str(tmp_path / "cache"))
    (tmp_path / "short.toml").write_text(PROFILE)

    def convert(*args: object, **keywords: object) -> None:
        try:
            signal.raise_signal(signal.SIGINT)
        except KeyboardInterrupt:
            sys.excepthook(*sys.exc_info())  # as the PyErr_Print of `import_array` does
            raise ImportError("numpy._core.multiarray failed to import") from None

    def drop(*args: object, **keywords: object) -> None:
        _Drops()
        time.sleep(60)

    def catch(*args: object, **keywords: object) -> None:
        try:
            signal.raise_signal(signal.SIGTERM)
        except BaseException:
            raise pipeline.ConfigError("something else") from None

    for change in (convert, drop, catch):
        monkeypatch.setattr(pipeline.steps, "fly", change)
        before = time.monotonic()
        assert main(["run", "short.toml"]) == 130
        assert time.monotonic() - before < 50
        assert capsys.readouterr().err.strip() == "error: interrupted"
        assert [path.name for path in tmp_path.iterdir()] == ["short.toml"]
