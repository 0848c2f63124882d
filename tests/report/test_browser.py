"""The report in Chromium: no error, no request, no sideways scrolling, readable colours."""

from __future__ import annotations

import json
import re
import shutil
import subprocess
from html import unescape
from pathlib import Path

import pytest

import bench
from bench.report import page
from tests.test_api import SHORT

BROWSER = shutil.which("chromium") or shutil.which("chromium-browser") or shutil.which("google-chrome")
pytestmark = pytest.mark.skipif(BROWSER is None, reason="no Chromium here")

LEAST_CONTRAST = 4.5
"""Of text, by WCAG 2.2, success criterion 1.4.3."""

FOLD = 900
"""A screen full [pixels]: the worst verdict and the plot of errors are on it."""

MEASURE = (Path(__file__).parent / "measure.js").read_text(encoding="utf-8")


@pytest.fixture(scope="module")
def text():
    outage = {**SHORT, "gnss_outage": [{"start_s": 10.0, "duration_s": 5.0}]}
    names = ["loose-15", "loose-22", "gnss-only", "baro-inertial", "free-inertial"]
    profile = bench.load_profile("figure-eight", outage, seed=3, estimators=names)
    return page.make_page("short", bench.run(profile))


@pytest.mark.parametrize(
    ("width", "scheme", "medium"),
    [(390, "dark", "screen"), (1440, "light", "screen"), (700, "light", "print")],
)
def test_the_report_in_a_browser(text, tmp_path, width, scheme, medium):
    """A copy without its policy, which would forbid the script that measures; A4 is 700 pixels wide."""
    copy = re.sub(r"<meta http-equiv=[^>]*>", "", text)
    if medium == "print":
        copy = copy.replace("@media print", "@media all")
    copy = copy.replace("</style>", f"html {{ width: {width}px; }}</style>")
    listen = (
        "<script>window.problems = []; addEventListener('error', (e) => problems.push(e.message));</script>"
    )
    path = tmp_path / "report.html"
    path.write_text(
        copy.replace("<style>", f"{listen}<style>").replace(
            "</body>", f"<script>const MEDIUM = '{medium}';{MEASURE}</script></body>"
        )
    )
    dark = ["--force-dark-mode", "--blink-settings=preferredColorScheme=0"] if scheme == "dark" else []
    done = subprocess.run(
        [BROWSER, "--headless=new", "--no-sandbox", "--disable-gpu", *dark,
         f"--window-size={max(width, 500)},900", f"--user-data-dir={tmp_path / 'user'}", "--dump-dom", f"file://{path}"],
        capture_output=True, text=True, timeout=120,
    )  # fmt: skip
    found = json.loads(unescape(re.search(r"<pre id=\"found\">(.*?)</pre>", done.stdout, re.DOTALL).group(1)))
    assert found["errors"] == []
    assert found["requests"] == 0
    assert found["beyond"] == []
    assert found["least"] >= LEAST_CONTRAST
    assert " s, " in found["cursor"]
    assert found["sorted"] > 5
    if medium == "screen":
        assert found["above"] <= found["top"] < FOLD
    assert (found["width"], found["dark"]) == (width, scheme == "dark")
