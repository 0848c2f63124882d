"""The report in Chromium: no error, no request, no sideways scrolling, readable colors."""

from __future__ import annotations

import hashlib
import json
import re
import shutil
import subprocess
from html import unescape
from pathlib import Path

import numpy as np
import pytest

import bench
from bench.core.files.places import PACKAGE
from bench.views.report import page
from tests.test_api import SHORT

BROWSER = shutil.which("chromium") or shutil.which("chromium-browser") or shutil.which("google-chrome")
pytestmark = pytest.mark.skipif(BROWSER is None, reason="no Chromium here")

LEAST_CONTRAST = 4.5
"""Of text, by WCAG 2.2, success criterion 1.4.3."""

FOLD = 900
"""A screen full [pixels]: the worst verdict and the plot of errors are on it."""

MEASURE = (Path(__file__).parent / "measure.js").read_text(encoding="utf-8")


@pytest.fixture(scope="module")
def result():
    outage = {**SHORT, "gnss_outage": [{"start_s": 10.0, "duration_s": 5.0}]}
    names = ["loose-15", "loose-22", "gnss-only", "baro-inertial", "free-inertial"]
    profile = bench.read_profile("figure-eight", outage, seed=3, estimators=names)
    return bench.run(profile)


@pytest.fixture(scope="module")
def text(result):
    return page.make_page("short", result)


def check_moved(found, result):
    """Raise AssertionError unless the first plot holds the errors, zooms by drag and can lose a filter."""
    label, errors = next(iter(result.errors.items()))
    t, drawn = (np.array(column, float) for column in zip(*found["line"], strict=True))
    size = np.hypot(*errors.pos_n[:, :2].T)
    shown = (t > 5.0) & np.isfinite(drawn)
    # a pixel holds several epochs: what is drawn lies between the least and the greatest of its neighbors
    near = [size[np.abs(errors.t - at) < 0.05] for at in t[shown]]
    off = [max(min(one) / v, v / max(one)) for one, v in zip(near, drawn[shown], strict=True)]
    assert max(off) < 1.01
    assert f" s, {label} " in found["cursor"]
    assert found["switched"]
    (low, high), (from_, to) = found["before"], found["closer"]
    assert low <= from_ < to <= high
    assert to / from_ < high / low
    (first, *others), end = found["zoomed"], result.truth.t[-1]
    assert first == pytest.approx([0.25 * end, 0.5 * end], abs=0.02 * end)
    assert all(one == first for one in others)
    assert 0 < len(found["left"]) < found["whole"]
    assert all("heading" in text for text in found["left"])
    numbers = [[value for value in group if value is not None] for group in found["order"]]
    assert numbers == [sorted(group) for group in numbers]
    assert found["back"] == pytest.approx([0.0, end], abs=1e-6)


def test_the_library_in_the_pages_is_that_of_its_authors():
    """The sums are those of ``npm pack uplot@1.6.32``."""
    sums = {
        "uPlot.iife.min.js": "19c8d4c6ad88929a79f4ae49d6f7161566dfd0ba3d15cc495e974f787eb78f1f",
        "uPlot.min.css": "df630c6a8d6f8eeaff264b50f73ce5b114f646ffd9a0bb74f049b0a00135fa04",
        "LICENSE": "8f989229699b4fe2f1a0432d0e9edc338a8a911e250e2d1b01ecd770a5f5b1bd",
    }
    folder = PACKAGE / "views" / "report" / "uplot"
    assert {path.name: hashlib.sha256(path.read_bytes()).hexdigest() for path in folder.iterdir()} == sums
    assert "uPlot (v1.6.32)" in (folder / "uPlot.iife.min.js").read_text()


@pytest.mark.parametrize(
    ("width", "scheme", "medium"),
    [(390, "dark", "screen"), (1440, "light", "screen"), (700, "light", "print")],
)
def test_the_report_in_a_browser(text, result, tmp_path, width, scheme, medium):
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
         f"--window-size={max(width, 500)},900", f"--user-data-dir={tmp_path / 'user'}",
         "--virtual-time-budget=5000", "--dump-dom", f"file://{path}"],
        capture_output=True, text=True, timeout=120,
    )  # fmt: skip
    found = json.loads(unescape(re.search(r"<pre id=\"found\">(.*?)</pre>", done.stdout, re.DOTALL).group(1)))
    assert found["errors"] == []
    assert found["requests"] == 0
    assert found["beyond"] == []
    assert found["least"] >= LEAST_CONTRAST
    assert found["sorted"] > 5
    if medium == "screen":
        assert found["above"] <= found["top"] < FOLD
        check_moved(found, result)
    assert (found["width"], found["dark"]) == (width, scheme == "dark")


def test_a_gap_between_two_points_of_a_line_stays_one_at_the_columns_of_other_lines(tmp_path):
    source = (PACKAGE / "views" / "report" / "page.js").read_text(encoding="utf-8")
    function = re.search(r"^function interpolate.*?^}", source, re.DOTALL | re.MULTILINE).group()
    call = (
        "const u = undefined, ys = [u, 1, u, 3, null, u, u, 5, u, u, 8, u]; interpolate([...ys.keys()], ys);"
    )
    path = tmp_path / "gap.html"
    path.write_text(f"<pre></pre><script>{function} {call} document.querySelector('pre').textContent = "
                    "JSON.stringify(ys.map((y) => y === undefined ? 'none' : y))</script>")  # fmt: skip
    done = subprocess.run(
        [BROWSER, "--headless=new", "--no-sandbox", "--disable-gpu", f"--user-data-dir={tmp_path / 'user'}",
         "--dump-dom", f"file://{path}"],
        capture_output=True, text=True, timeout=120,
    )  # fmt: skip
    found = json.loads(unescape(re.search(r"<pre>(.*?)</pre>", done.stdout).group(1)))
    assert found == ["none", 1, 2, 3, None, None, None, 5, 6, 7, 8, "none"]
