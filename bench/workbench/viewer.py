"""The verb view: start the viewer of the rerun wheel on a results folder, and end it."""

from __future__ import annotations

import contextlib
import ctypes
import os
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Sequence
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING

from rich.console import Console

from bench.errors import ConfigError, ViewerError
from bench.store import CAMPAIGN_RESULT, RECORDING, RESULT, read_summary
from bench.workbench import web_page
from bench.workbench.flight_verbs import RUNS
from bench.workbench.web_page import LOCAL

if TYPE_CHECKING:
    from bench.recording.live import LiveFlight

_PATIENCE = 5.0  # between SIGTERM and SIGKILL [s]
_START = 20.0  # until the viewer takes a flight [s]
_LOOK = 0.5  # between looks at the parent [s]
_PR_SET_PDEATHSIG = 1  # of <linux/prctl.h>


def view(folder: Path | None, *, web: bool, console: Console) -> None:
    """Open the viewer on a results folder and wait until it is closed.

    Parameters
    ----------
    folder : Path or None
        A results folder; None for the newest one below ``runs``.
    web : bool
        Serve it to a browser on this machine instead of opening a window.
    console : Console
        Where the address is printed.

    Raises
    ------
    ConfigError
        If there is no recording in the folder.
    ViewerError
        If the viewer cannot be started or fails.
    """
    recording = find_recording(folder)
    viewer = str(_find_viewer())
    with contextlib.ExitStack() as stack:
        if web:
            port, inner = free_port(9090), free_port(0)
            page = stack.enter_context(web_page.serve(recording, port, inner))
            console.print(f"{recording} is served on {page}", soft_wrap=True)
            console.print("Ctrl-C ends it.")
            command = [viewer, page, "--serve-web", "--web-viewer-port", str(inner)]
        else:
            _check_display()
            command = [viewer, str(recording), "--port", "auto", "--hide-welcome-screen"]
        command += ["--bind", LOCAL]
        status = wait_for(command)
    if status:
        raise ViewerError(f"the viewer ended with status {status}: {' '.join(command)}")


def show_live(name: str, console: Console) -> LiveFlight | None:
    """Do what :func:`open_live` does, or say in a line why not."""
    try:
        return open_live(name)
    except ViewerError as error:
        console.print(f"Nothing is shown live: {error}.")
        return None


def open_live(name: str) -> LiveFlight:
    """Open the viewer for the flight of a profile, and return what shows it there piece by piece.

    The window stays until it is closed.

    Raises
    ------
    ViewerError
        If it cannot be opened.
    """
    _check_display()
    port = free_port(9876)
    child = _start_viewer(port)
    until = time.monotonic() + _START
    while not _listens(port):
        if child.poll() is not None or time.monotonic() > until:
            _end_group(child)
            raise ViewerError(f"the viewer did not start within {_START:g} s")
        time.sleep(0.1)
    from bench.recording import live

    return live.connect(name, f"rerun+http://{LOCAL}:{port}/proxy")


def _start_viewer(port: int) -> subprocess.Popen[bytes]:
    command = [str(_find_viewer()), "--port", str(port), "--bind", LOCAL, "--hide-welcome-screen"]
    nowhere = subprocess.DEVNULL
    return subprocess.Popen(command, start_new_session=True, stdout=nowhere, stderr=nowhere)


def _listens(port: int) -> bool:
    with socket.socket() as probe:
        return probe.connect_ex((LOCAL, port)) == 0


def find_recording(folder: Path | None) -> Path:
    """Return the recording of a results folder, or of the newest one below ``runs``.

    Raises
    ------
    ConfigError
        If there is no recording.
    """
    if folder is None:
        results = [path for path in RUNS.glob(f"*/{RESULT}") if (path.parent / RECORDING).is_file()]
        if not results:
            raise ConfigError(f"{RUNS}: no recording in any folder; 'bench run figure-eight' makes one")
        folder = max(results, key=lambda path: path.stat().st_mtime).parent
    if not (folder / CAMPAIGN_RESULT).is_file():
        read_summary(folder)
    recording = folder / RECORDING
    if not recording.is_file():
        raise ConfigError(f"{folder}: no {RECORDING} in it; 'bench record' makes one")
    return recording


def wait_for(command: Sequence[str]) -> int:
    """Run a command in its own process group and return its status; the group is ended on return.

    It is ended too when the process that started this one ends, unless SIGHUP is ignored (nohup), and on
    Linux when this process is killed.
    """
    parent, stays = os.getppid(), signal.getsignal(signal.SIGHUP) == signal.SIG_IGN
    child = subprocess.Popen(command, start_new_session=True, preexec_fn=_end_with_parent)
    try:
        while stays or os.getppid() == parent:
            with contextlib.suppress(subprocess.TimeoutExpired):
                return child.wait(_LOOK)
        return 0
    finally:
        _end_group(child)


def _end_with_parent() -> None:
    """In a new child: ask Linux to kill it when its parent ends."""
    if sys.platform == "linux":
        ctypes.CDLL(None).prctl(_PR_SET_PDEATHSIG, int(signal.SIGKILL))


def free_port(wanted: int) -> int:
    """Return the wanted port of this machine, or another one if it is in use."""
    for port in (wanted, 0):
        with socket.socket() as probe, contextlib.suppress(OSError):
            probe.bind((LOCAL, port))
            return int(probe.getsockname()[1])
    raise ViewerError(f"no free port on {LOCAL}")


def _end_group(child: subprocess.Popen[bytes]) -> None:
    """End a process group: SIGTERM, then SIGKILL."""
    for number in (signal.SIGTERM, signal.SIGKILL):
        with contextlib.suppress(ProcessLookupError, PermissionError):
            os.killpg(child.pid, number)
        with contextlib.suppress(subprocess.TimeoutExpired):
            child.wait(_PATIENCE)


def _find_viewer() -> Path:
    """Return the path of the viewer itself; its Python launcher would leave it running."""
    package = find_spec("rerun_cli")
    if package is not None and package.origin is not None:
        folder = Path(package.origin).parent
        for name in ("rerun", "rerun.exe", "Rerun.app/Contents/MacOS/Rerun"):
            if (folder / name).is_file():
                return folder / name
    raise ViewerError("no viewer found in the package rerun-sdk; 'pip install rerun-sdk' installs it")


def _check_display() -> None:
    if sys.platform == "linux" and not (os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY")):
        raise ViewerError("no display for a window; 'bench view --web' serves the recording to a browser")
