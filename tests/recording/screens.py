"""A picture of each tab of a recording, made by the real viewer without a display.

``python -m tests.recording.screens RECORDING.rrd FOLDER [SECONDS]`` writes FOLDER/<tab>.png with the cursor
at that time. It needs a software renderer (Debian: mesa-vulkan-drivers).
"""

from __future__ import annotations

import re
import socket
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import rerun_cli
from rerun.experimental import ViewerClient

from bench.recording.drawing import TIMELINE

WIDTH = 1440
"""Of a picture [pixels]."""


def find_problem() -> str:
    """Return why the viewer cannot be started without a display; empty if it can."""
    try:
        with _spawn() as viewer:
            return "" if viewer.take_screenshot(max_size=100) else "it makes no picture"
    except Exception as error:  # whatever a machine without a renderer makes of it
        return str(error).splitlines()[0] if str(error) else type(error).__name__


@contextmanager
def open_viewer(recording: Path) -> Iterator[Any]:
    """Provide a viewer that shows a recording."""
    with _spawn() as viewer:
        viewer.open(str(recording.absolute()))
        time.sleep(2.0)
        yield viewer


@contextmanager
def _spawn() -> Iterator[Any]:
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    tool = Path(rerun_cli.__file__).parent / "rerun"
    viewer = ViewerClient.spawn(headless=True, port=port, executable_path=str(tool), hide_welcome_screen=True)
    try:
        yield viewer
    finally:
        viewer.quit()


def show_tabs(viewer: Any, at: float) -> Iterator[tuple[str, bytes]]:
    """Yield the name of each tab, and a picture of it with the cursor at a time [s]."""
    blueprint = viewer.get_blueprint().blueprint
    tabs = blueprint["/viewport"]["ViewportBlueprint"]["root_container"]
    container = blueprint[f"/container/{tabs}"]["ContainerBlueprint"]
    for tab in container["contents"]:
        ((_, fields),) = (item for item in blueprint[f"/{tab}"].items() if "display_name" in item[1])
        container["active_tab"] = tab
        viewer.set_blueprint(blueprint, "recording")
        viewer.set_time(TIMELINE, duration=at, play_state="paused")
        time.sleep(2.0)
        yield fields["display_name"], viewer.take_screenshot(max_size=WIDTH)


def main(recording: str, folder: str, at: str = "0") -> None:
    out = Path(folder)
    out.mkdir(parents=True, exist_ok=True)
    with open_viewer(Path(recording)) as viewer:
        for name, picture in show_tabs(viewer, float(at)):
            path = out / f"{re.sub(r'[^a-z0-9]+', '-', name.lower())}.png"
            path.write_bytes(picture)
            print(path)


if __name__ == "__main__":
    main(*sys.argv[1:])
