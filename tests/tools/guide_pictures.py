"""Make the pictures of the guide again: ``make pictures``. It needs Chromium and about ten minutes.

What they show is made below ``build/pictures`` by the commands that the guide names; what is there from an
earlier time is taken. ``python -m tests.tools.guide_pictures NAME...`` makes only these pictures.
"""

from __future__ import annotations

import datetime
import io
import itertools
import os
import subprocess
import sys
import tempfile
from collections.abc import Callable, Mapping
from pathlib import Path

from PIL import Image
from PIL.PngImagePlugin import PngInfo

import bench
from bench.cli.verbs.guide import FOLDER, find_pages
from tests.flight import gust_spectra
from tests.recording.screens import show_in_browser, take_picture
from tests.tools import docs_site

ROOT = Path(__file__).parents[2]
BUILD = ROOT / "build" / "pictures"
MOST_BYTES = 150_000
"""Size of a picture; the wheel holds all of them."""

_WIDTH, _HEIGHT = 1200, 750  # of a screen [pixels]
_RUN = ("run", "figure-eight")
_CAMPAIGN = ("campaign", "figure-eight", "-e", "loose-full", "-e", "loose-15", "--runs", "40")
_CARD = ("card", "-e", "loose-15", "--quick")
_LOG = ("navigate", "tests/logs/flights/copter.bin")
_BUDGET = ("study", "budget", "figure-eight", "--estimator", "loose-22")


def main(*names: str) -> None:
    for name in names or PICTURES:
        with tempfile.TemporaryDirectory() as scratch:
            path = find_pages().get(name, FOLDER / name).with_suffix(".png")
            path.write_bytes(shrink(PICTURES[name](Path(scratch))))
        print(f"{path}: {path.stat().st_size / 1e3:.0f} kB")


def shrink(picture: bytes) -> bytes:
    """Return a picture as a PNG; if it needs more room, of 256 colors, and smaller."""
    with Image.open(io.BytesIO(picture)) as image:
        whole = image.convert("RGB")
    made = PngInfo()
    made.add_text("Source", name_source())
    for part in (None, 1.0, 0.9, 0.8, 0.7):
        shown = whole
        if part is not None:
            size = round(whole.width * part), round(whole.height * part)
            shown = whole.resize(size, Image.Resampling.LANCZOS).quantize(256, dither=Image.Dither.NONE)
        stream = io.BytesIO()
        shown.save(stream, "PNG", optimize=True, pnginfo=made)
        if stream.tell() <= MOST_BYTES:
            break
    return stream.getvalue()


def name_source() -> str:
    """Return version and commit of bench, and the day, as pages and pictures have them."""
    commit = subprocess.run(
        ["git", "rev-parse", "--short=8", "HEAD"], cwd=ROOT, capture_output=True, text=True, check=True
    ).stdout.strip()
    return f"bench {bench.__version__}, commit {commit}, {datetime.date.today().isoformat()}"


def make(name: str, command: tuple[str, ...], option: str = "-o") -> Path:
    """Return what a command of bench writes; it runs unless that is there."""
    place = BUILD / name
    if not place.exists():
        run(*command, option, str(place))
    return place


def run(*command: str) -> str:
    """Return what a command of bench prints on a terminal of 80 columns, in colors."""
    there = {"COLUMNS": "80", "FORCE_COLOR": "1", "TTY_INTERACTIVE": "0", "TERM": "xterm-256color"}
    done = subprocess.run(
        [sys.executable, "-m", "bench", *command], cwd=ROOT, env=os.environ | there, text=True,
        stdout=subprocess.PIPE,
    )  # fmt: skip
    if done.returncode not in (0, 1):  # 1: a verdict is negative
        raise RuntimeError(f"bench {' '.join(command)}: status {done.returncode}\n{done.stdout}")
    return done.stdout


def show_page(page: Path, scratch: Path, height: int = _HEIGHT) -> bytes:
    return take_picture(page.absolute().as_uri(), scratch, _WIDTH, height)


def show_tab(k: int, scratch: Path) -> bytes:
    tabs = show_in_browser(make("run", _RUN), scratch, _WIDTH, _HEIGHT)
    return next(itertools.islice(tabs, k, None))[1]


def show_card(scratch: Path) -> bytes:
    card = make("card.json", (*_CARD, "--runs", str(BUILD / "card"), "--html", str(BUILD / "card.html")))
    return show_page(card.with_suffix(".html"), scratch)


def show_budget(scratch: Path) -> bytes:
    study = bench.read_study(make("budget", _BUDGET))
    stream = io.BytesIO()
    name = next(
        name for name, plot in study.figures.items() if "heading" in plot.title and "share" in plot.title
    )
    study.plot(name).savefig(stream, format="png")
    return stream.getvalue()


def show_gusts(scratch: Path) -> bytes:
    gust_spectra.draw()  # into the guide
    return (FOLDER / "gusts.png").read_bytes()


def show_docs(scratch: Path) -> bytes:
    return show_page(docs_site.build(ROOT / "build" / "docs") / "index.html", scratch)


PICTURES: Mapping[str, Callable[[Path], bytes]] = {
    "report": lambda scratch: show_page(make("run", _RUN) / "report.html", scratch),
    "figure-eight": lambda scratch: show_tab(0, scratch),
    "comparison": lambda scratch: show_tab(1, scratch),
    "campaign": lambda scratch: show_page(make("campaign", _CAMPAIGN) / "report.html", scratch),
    "card": show_card,
    "autopilots": lambda scratch: show_page(make("log", _LOG) / "report.html", scratch),
    "budget": show_budget,
    "gusts": show_gusts,
    "docs": show_docs,
}
"""Name of a picture -> what makes it."""


if __name__ == "__main__":
    main(*sys.argv[1:])
