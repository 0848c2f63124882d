"""The verb view: start the viewer of the rerun wheel with a recording, and end it."""

from __future__ import annotations

import contextlib
import ctypes
import os
import queue
import signal
import socket
import subprocess
import sys
import threading
from collections.abc import Iterator, Sequence
from importlib.util import find_spec
from pathlib import Path

from rich.console import Console

from bench.cli.verbs import web_page
from bench.cli.verbs.flight_verbs import RUNS
from bench.cli.verbs.web_page import LOCAL
from bench.core.files.file_checks import check_file
from bench.core.records.run_records import ShowFlight
from bench.core.words.exceptions import ConfigError, ViewerError
from bench.io.results import CAMPAIGN_RESULT, RECORDING, RESULT, read_summary

PATIENCE = 5.0  # between SIGTERM and SIGKILL, and until the viewer has taken a flight [s]
_LOOK = 0.5  # between looks at the parent [s]
_MAGIC = b"RRF"  # first bytes of a recording of rerun; its version follows
_MOST_BYTES = 1 << 40  # of a recording, which the viewer reads [byte]
_PR_SET_PDEATHSIG = 1  # of <linux/prctl.h>


def view(path: Path | None, *, web: bool, console: Console) -> None:
    """Open the viewer on a recording and wait until it is closed.

    Parameters
    ----------
    path : Path or None
        A recording or a results folder; None for the newest one below ``runs``.
    web : bool
        Serve it to a browser on this machine instead of opening a window.
    console : Console
        Where the address is printed.

    Raises
    ------
    ConfigError
        If there is no recording.
    ViewerError
        If the viewer cannot be started or fails.
    """
    recording = find_recording(path)
    viewer = str(find_viewer())
    with contextlib.ExitStack() as stack:
        if web:
            port, inner = free_port(9090), free_port(0)
            page = stack.enter_context(web_page.serve(recording, port, inner))
            console.print(f"{recording} is served on {page}", soft_wrap=True)
            console.print("Ctrl-C ends it.")
            command = [viewer, page, "--serve-web", "--web-viewer-port", str(inner)]
        else:
            _check_display("'bench view --web' serves the recording to a browser")
            command = [viewer, str(recording), "--port", "auto", "--hide-welcome-screen"]
        command += ["--bind", LOCAL]
        status = wait_for(command)
    if status:
        raise ViewerError(f"the viewer ended with status {status}: {' '.join(command)}")


@contextlib.contextmanager
def show_live(name: str, console: Console) -> Iterator[ShowFlight | None]:
    """Return the function that shows a flight in a viewer piece by piece; print the reason if there is none.

    The flight does not wait for the viewer. At the end there is a line if it has not taken all. Its window
    stays until it is closed.
    """
    from bench.views.recording import live

    try:
        _check_display("the run goes on without --live")
        feed = _Feed(_start_viewer())
    except ViewerError as error:
        console.print(f"Nothing is shown live: {error}.", soft_wrap=True)
        yield None
        return
    try:
        yield live.make_show(name, feed.send)
    except BaseException:
        feed.close(0.0)
        raise
    if problem := feed.close(PATIENCE):
        console.print(f"{problem}: not all of the flight is shown live.", soft_wrap=True)


def _start_viewer() -> subprocess.Popen[bytes]:
    """Start a viewer that shows the data from its standard input."""
    command = [str(find_viewer()), "-", "--port", "auto", "--bind", LOCAL, "--hide-welcome-screen"]
    nowhere = subprocess.DEVNULL
    try:
        return subprocess.Popen(
            command, bufsize=0, start_new_session=True, stdin=subprocess.PIPE, stdout=nowhere, stderr=nowhere
        )
    except OSError as error:
        raise ViewerError(f"{command[0]}: {error.strerror or error}") from None


class _Feed:
    """Writer to the standard input of a viewer, in a thread because a viewer may read late or never."""

    def __init__(self, viewer: subprocess.Popen[bytes]) -> None:
        self._viewer = viewer
        self._gone = False
        self._parts = queue.SimpleQueue[bytes]()
        self._thread = threading.Thread(target=self._write, daemon=True)
        self._thread.start()

    def send(self, data: bytes) -> None:
        """Queue data for the viewer, if it still reads."""
        if not self._gone:
            self._parts.put(data)

    def close(self, patience: float) -> str:
        """Wait up to a time [s] until all data are written; return the error of the viewer, or ""."""
        self._parts.put(b"")
        self._thread.join(patience)
        if self._thread.is_alive():
            return "The viewer takes nothing more"
        return "The viewer has gone" if self._gone or self._viewer.poll() is not None else ""

    def _write(self) -> None:
        pipe = self._viewer.stdin
        assert pipe is not None
        with contextlib.suppress(OSError), pipe:
            while data := self._parts.get():
                rest = memoryview(data)
                while rest:
                    rest = rest[pipe.write(rest) :]
            return
        self._gone = True


def find_recording(path: Path | None) -> Path:
    """Return a recording by its file or its folder, or the newest one below ``runs``.

    Raises
    ------
    ConfigError
        If there is no recording.
    """
    if path is None:
        results = [path for path in RUNS.glob(f"*/{RESULT}") if (path.parent / RECORDING).is_file()]
        if not results:
            raise ConfigError(f"{RUNS}: no recording in any folder; 'bench run figure-eight' makes one")
        path = max(results, key=lambda path: path.stat().st_mtime).parent
    if not path.is_dir():
        return _check_recording(path)
    if not (path / CAMPAIGN_RESULT).is_file():
        read_summary(path)
    recording = path / RECORDING
    if not recording.is_file():
        raise ConfigError(f"{path}: no {RECORDING} in it; 'bench record' makes one")
    return recording


def _check_recording(path: Path) -> Path:
    try:
        check_file(path, str(path), _MOST_BYTES)
        with path.open("rb") as file:
            start = file.read(len(_MAGIC))
    except FileNotFoundError:
        raise ConfigError(f"{path}: no such file or folder") from None
    except OSError as error:
        raise ConfigError(f"{path}: {error.strerror}") from None
    if start != _MAGIC:
        raise ConfigError(f"{path}: is not a rerun recording. Give a .rrd file or a results folder")
    return path


def wait_for(command: Sequence[str]) -> int:
    """Run a command in its own process group and return its status; the group is ended on return.

    It is ended too when the process that started this one ends, unless SIGHUP is ignored (nohup), and on
    Linux when this process is killed. On Windows it is a plain child.
    """
    if sys.platform == "win32":
        return subprocess.call(command)
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
    """Return the requested port of this machine, or another port if it is in use."""
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
            child.wait(PATIENCE)


def find_viewer() -> Path:
    """Return the path of the viewer itself; its Python launcher would leave it running."""
    package = find_spec("rerun_cli")
    if package is not None and package.origin is not None:
        folder = Path(package.origin).parent
        for name in ("rerun", "rerun.exe", "Rerun.app/Contents/MacOS/Rerun"):
            if (folder / name).is_file():
                return folder / name
    raise ViewerError("no viewer found in the package rerun-sdk; 'pip install rerun-sdk' installs it")


def _check_display(words: str) -> None:
    if sys.platform == "linux" and not (os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY")):
        raise ViewerError(f"no display for a window; {words}")
