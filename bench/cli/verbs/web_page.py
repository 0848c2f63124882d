"""Serve the page of the viewer and one recording to a browser on this machine only.

A web site that a browser shows can make its own name lead to 127.0.0.1 and so ask a local server. Such a
request has the site's name in its header ``Host``; it is rejected.
"""

from __future__ import annotations

import contextlib
import http.client
import shutil
import threading
from collections.abc import Iterator
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path

LOCAL = "127.0.0.1"
_RECORDING = "/flight.rrd"
_PATIENCE = 10.0  # of the viewer with an answer [s]
_PASSED_ON = ("Content-Type", "Content-Length", "Content-Encoding", "rerun-final-length")


@contextlib.contextmanager
def serve(recording: Path, port: int, viewer_port: int) -> Iterator[str]:
    """Serve a recording and, from the viewer at a port of this machine, its page; provide the address.

    Raises
    ------
    OSError
        If the port is in use.
    """

    class Handler(_FileHandler):
        file, inner = recording, viewer_port

    with ThreadingHTTPServer((LOCAL, port), Handler) as server:
        threading.Thread(target=server.serve_forever, daemon=True).start()
        try:
            here = f"{LOCAL}:{server.server_port}"
            yield f"http://{here}/?url=http%3A%2F%2F{here.replace(':', '%3A')}%2F{_RECORDING[1:]}"
        finally:
            server.shutdown()


class _FileHandler(BaseHTTPRequestHandler):
    """Answer GET of the recording and of the files of the page."""

    file: Path
    inner: int

    def do_GET(self) -> None:
        """Send a file, if the request names this server as its host."""
        port = self.connection.getsockname()[1]
        with contextlib.suppress(OSError):  # the browser has left
            if self.headers.get_all("Host") not in ([f"{LOCAL}:{port}"], [f"localhost:{port}"]):
                self.send_response_only(403)
                self.send_header("Content-Length", "0")
                self.end_headers()
            elif self.path.partition("?")[0] == _RECORDING:
                self._send_recording()
            else:
                self._pass_on()

    def _send_recording(self) -> None:
        with self.file.open("rb") as source:
            self.send_response_only(200)
            self.send_header("Content-Type", "application/octet-stream")
            self.send_header("Content-Length", str(self.file.stat().st_size))
            self.end_headers()
            shutil.copyfileobj(source, self.wfile)

    def _pass_on(self) -> None:
        """Send the response of the viewer; 503 until the viewer has started."""
        viewer = http.client.HTTPConnection(LOCAL, self.inner, timeout=_PATIENCE)
        try:
            viewer.request("GET", self.path)
            answer = viewer.getresponse()
            self.send_response_only(answer.status)
            for name in _PASSED_ON:
                if value := answer.getheader(name):
                    self.send_header(name, value)
            self.end_headers()
            shutil.copyfileobj(answer, self.wfile)
        except (OSError, http.client.HTTPException):
            self.send_error(503)
        finally:
            viewer.close()

    def log_message(self, format: str, *args: object) -> None:  # noqa: A002
        """Print nothing."""
