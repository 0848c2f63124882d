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

MEASURE = (Path(__file__).parent / "measure.js").read_text(encoding="utf-8")


@pytest.fixture(scope="module")
def text():
    outage = {**SHORT, "gnss_outage": [{"start_s": 10.0, "duration_s": 5.0}]}
    profile = bench.load_profile("figure-eight", outage, seed=3, estimators=["loose-15", "free-inertial"])
    return page.make_page("short", bench.run(profile))


@pytest.mark.parametrize(("width", "scheme"), [(500, "dark"), (1440, "light")])
def test_the_report_in_a_browser(text, tmp_path, width, scheme):
    """A copy without its policy, which would forbid the script that measures."""
    copy = re.sub(r"<meta http-equiv=[^>]*>", "", text)
    listen = (
        "<script>window.problems = []; addEventListener('error', (e) => problems.push(e.message));</script>"
    )
    path = tmp_path / "report.html"
    path.write_text(
        copy.replace("<style>", f"{listen}<style>").replace("</body>", f"<script>{MEASURE}</script></body>")
    )
    dark = ["--force-dark-mode", "--blink-settings=preferredColorScheme=0"] if scheme == "dark" else []
    done = subprocess.run(
        [BROWSER, "--headless=new", "--no-sandbox", "--disable-gpu", f"--window-size={width},900", *dark,
         f"--user-data-dir={tmp_path / 'user'}", "--dump-dom", f"file://{path}"],
        capture_output=True, text=True, timeout=120,
    )  # fmt: skip
    found = json.loads(unescape(re.search(r"<pre id=\"found\">(.*?)</pre>", done.stdout, re.DOTALL).group(1)))
    assert found["errors"] == []
    assert found["requests"] == 0
    assert found["wide"] <= 0
    assert found["least"] >= LEAST_CONTRAST
    assert " s, " in found["cursor"]
    assert found["sorted"] > 5
    assert (found["width"], found["dark"]) == (width, scheme == "dark")
