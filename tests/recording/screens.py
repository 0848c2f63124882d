"""Pictures of each tab of a recording, by the real viewer without a display and in Chromium, and of a report.

``python -m tests.recording.screens DIR OUT [SECONDS]`` writes OUT/native-<tab>.png, with the cursor at that
time, OUT/web-<tab>.png as a browser opens it, and OUT/report-390.png, report-1440.png of a results folder.
The viewer needs a software renderer (Debian: mesa-vulkan-drivers), the rest needs Chromium.
"""

from __future__ import annotations

import asyncio
import base64
import json
import re
import socket
import subprocess
import sys
import tempfile
import time
import urllib.request
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any
from unittest import mock

import rerun_cli
from rerun.experimental import ViewerClient
from tornado.websocket import websocket_connect

import bench
from bench.cli.verbs import web_page
from bench.cli.verbs.viewer import free_port
from bench.views import recording
from bench.views.plots.content import gather_content
from bench.views.plots.tabs import TABS
from bench.views.recording import layout
from bench.views.recording.drawing import TIMELINE

WIDTH = 1440
"""Of a picture [pixels]."""

_PATIENCE = 300.0  # with a viewer that draws without a graphics card on a busy machine [s]
_EMPTY = 40_000  # the viewer's page with nothing in it is a smaller picture [bytes]


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
        wait_for(recording.name, lambda: _is_open(viewer))
        yield viewer


def wait_for(what: str, ready: Callable[[], object]) -> None:
    """Wait until something is so; TimeoutError if it never is."""
    begun = time.monotonic()
    while not ready():
        if time.monotonic() - begun > _PATIENCE:
            raise TimeoutError(f"{what}: not ready after {_PATIENCE:.0f} s")
        time.sleep(0.1)


def _is_open(viewer: Any) -> bool:
    """Return whether a viewer has read all of its recording."""
    state = viewer.get_state()
    return bool(not state.loading and state.views and any(one.timelines for one in state.recordings))


def _photograph_native(viewer: Any) -> bytes:
    """Return a picture of a viewer as soon as two in a row are the same."""
    pictures = [b""]

    def is_still() -> bool:
        time.sleep(0.4)
        pictures.append(viewer.take_screenshot(max_size=WIDTH))
        return pictures[-1] == pictures[-2]

    wait_for("the picture", is_still)
    return pictures[-1]


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
        wait_for(fields["display_name"], lambda tab=tab: _find_tab(viewer, tabs) == tab)
        yield fields["display_name"], _photograph_native(viewer)


def _find_tab(viewer: Any, tabs: str) -> str:
    """Return the tab that is open."""
    blueprint = viewer.get_blueprint().blueprint
    return str(blueprint[f"/container/{tabs}"]["ContainerBlueprint"]["active_tab"])


def show_in_browser(
    folder: Path, scratch: Path, width: int = WIDTH, height: int = 810
) -> Iterator[tuple[str, bytes]]:
    """Yield the name of each tab of a results folder, and a picture of it as `bench view --web` serves it."""
    result = bench.read_result(folder)
    content = gather_content(result)
    assert content is not None
    names = ["Overview", *(tab.name for tab in TABS if any(map(any, tab.plots(content).values())))]
    for k, name in enumerate(names):

        def choose(*arguments: Any, tab: int = k, make: Any = layout.make_blueprint) -> Any:
            blueprint = make(*arguments)
            blueprint.root_container.active_tab = tab
            return blueprint

        path = scratch / f"{k}.rrd"
        with mock.patch.object(layout, "make_blueprint", choose):
            recording.write(path, result.name, result)
        port, inner = free_port(0), free_port(0)
        with web_page.serve(path, port, inner) as page:
            tool = str(Path(rerun_cli.__file__).parent / "rerun")
            options = ["--serve-web", "--web-viewer-port", str(inner), "--bind", web_page.LOCAL]
            viewer = subprocess.Popen([tool, page, *options], stderr=subprocess.DEVNULL)
            try:
                wait_for(page, lambda page=page: _answers(page))
                yield name, take_picture(f"{page}&renderer=webgl", scratch, width, height, _EMPTY, dark=True)
            finally:
                viewer.kill()
                viewer.wait()


def _answers(page: str) -> bool:
    """Return whether a server sends a page."""
    try:
        with urllib.request.urlopen(page) as answer:
            return bool(answer.status == 200)
    except OSError:
        return False


def take_picture(
    address: str, scratch: Path, width: int, height: int, least: int = 0, *, dark: bool = False
) -> bytes:
    """Return a picture of a page in Chromium that stays the same and has more than so many bytes."""
    options = ["--headless=new", "--no-sandbox", "--hide-scrollbars", "--use-angle=swiftshader"]
    options += ["--enable-unsafe-swiftshader", "--remote-debugging-port=0", "--remote-allow-origins=*"]
    command = ["chromium", *options, f"--user-data-dir={scratch / 'user'}", "about:blank"]
    browser = subprocess.Popen(command, stderr=subprocess.PIPE, text=True)
    try:
        assert browser.stderr is not None
        told = next(line for line in browser.stderr if "DevTools listening" in line)
        (port,) = re.findall(r"ws://127\.0\.0\.1:(\d+)/", told)
        return asyncio.run(_photograph(port, address, width, height, least, dark))
    finally:
        browser.kill()
        browser.wait()


async def _photograph(port: str, address: str, width: int, height: int, least: int, dark: bool) -> bytes:
    """Return a picture by the browser whose tools listen at a port of this machine."""
    with urllib.request.urlopen(f"http://127.0.0.1:{port}/json/list") as answer:
        page = next(one for one in json.load(answer) if one["type"] == "page")
    socket_ = await websocket_connect(page["webSocketDebuggerUrl"], max_message_size=2**27)

    async def call(method: str, **params: Any) -> dict[str, Any]:
        await socket_.write_message(json.dumps({"id": 1, "method": method, "params": params}))
        while True:
            found = json.loads(await socket_.read_message() or "{}")
            if found.get("id") == 1:
                return dict(found["result"])

    size = {"width": width, "height": height, "deviceScaleFactor": 1, "mobile": False}
    await call("Emulation.setDeviceMetricsOverride", **size)
    await call("Emulation.setFocusEmulationEnabled", enabled=True)
    scheme = {"name": "prefers-color-scheme", "value": "dark" if dark else "light"}
    await call("Emulation.setEmulatedMedia", features=[scheme])
    await call("Page.navigate", url=address)
    begun, same, picture = time.monotonic(), 0, b""
    while same < 3:
        if time.monotonic() - begun > _PATIENCE:
            raise TimeoutError(f"{address}: not drawn after {_PATIENCE:.0f} s")
        await asyncio.sleep(1.0)
        for k in (1, 0):  # the viewer waits for a mouse that moves; where it opens no tooltip
            await call("Input.dispatchMouseEvent", type="mouseMoved", x=k, y=height - 1)
        last, picture = picture, base64.b64decode((await call("Page.captureScreenshot"))["data"])
        same = same + 1 if picture == last and len(picture) > least else 0
    return picture


def show_report(folder: Path, scratch: Path) -> Iterator[tuple[int, bytes]]:
    """Yield the width of a page [pixels] and a picture of the report in it."""
    for width in (390, WIDTH):
        yield width, take_picture((folder / "report.html").absolute().as_uri(), scratch, width, 6000)


def main(folder: str, out: str, at: str = "0") -> None:
    to = Path(out)
    to.mkdir(parents=True, exist_ok=True)

    def write(kind: str, name: object, picture: bytes) -> None:
        path = to / f"{kind}-{re.sub(r'[^a-z0-9]+', '-', str(name).lower())}.png"
        path.write_bytes(picture)
        print(path)

    with tempfile.TemporaryDirectory() as scratch:
        for width, picture in show_report(Path(folder), Path(scratch)):
            write("report", width, picture)
        with open_viewer(Path(folder) / "flight.rrd") as viewer:
            for name, picture in show_tabs(viewer, float(at)):
                write("native", name, picture)
        for name, picture in show_in_browser(Path(folder), Path(scratch)):
            write("web", name, picture)


if __name__ == "__main__":
    main(*sys.argv[1:])
