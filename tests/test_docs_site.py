"""The documentation as a site: every link leads somewhere, nothing of it comes from the network."""

from __future__ import annotations

import json
import re

import pytest
from PIL import Image

import bench
from bench.cli.verbs.guide import FOLDER, find_pages, read_topics
from bench.core.files.places import PACKAGE
from tests.tools import docs_site
from tests.tools.api_pages import TOPICS
from tests.tools.guide_pictures import MOST_BYTES, PICTURES


@pytest.fixture(scope="module")
def site(tmp_path_factory):
    return docs_site.build(tmp_path_factory.mktemp("docs") / "site", ["approach"])


def test_every_page_is_there_and_loads_nothing_from_elsewhere(site):
    names = {"index", *read_topics(), "gallery", *TOPICS}
    assert {path.stem for path in site.glob("*.html")} == names
    for path in site.rglob("*.html"):
        text = path.read_text(encoding="utf-8")
        loaded = re.findall(r"<(?:script|img|iframe)[^>]*\bsrc=\"([^\"]+)\"", text)
        loaded += re.findall(r"<link[^>]*\bhref=\"([^\"]+)\"", text)
        assert loaded
        for one in loaded:
            assert "//" not in one, f"{path.name} loads {one}"
            assert (path.parent / one.partition("?")[0].partition("#")[0]).exists(), f"{path.name}: {one}"


def test_no_fence_is_shown_as_text(site):
    for path in site.rglob("*.html"):
        assert "```" not in path.read_text(encoding="utf-8"), path.name
    assert ">log.toml<" in (site / "own-log.html").read_text(encoding="utf-8")


def test_the_script_of_the_pages_asks_the_network_for_no_viewer_of_pictures(site):
    (bundle,) = (site / "assets" / "javascripts").glob("bundle.*.js")
    assert ".glightbox" not in bundle.read_text(encoding="utf-8")


def test_the_search_is_a_script_that_a_folder_can_hold(site):
    text = (site / "search.js").read_text(encoding="utf-8")
    assert "NEES" in text
    index = json.loads((site / "search.json").read_text(encoding="utf-8"))
    assert len(index["items"]) > 200


def test_every_public_name_is_on_one_page_with_its_errors(site):
    named = [name for _, names in TOPICS.values() for name in names if "." not in name]
    assert sorted(named) == sorted(name for name in bench.__all__ if name[0] != "_")
    for page, (_, names) in TOPICS.items():
        text = (site / f"{page}.html").read_text(encoding="utf-8")
        assert [name for name in names if f">{name.rpartition('.')[2]}<" not in text] == []
    page = (site.parent / "pages" / "api-run.md").read_text(encoding="utf-8")
    one = page.partition("## run\n")[2].partition("## ")[0]
    assert "profile: str | Path | Profile," in one
    assert "**Raises**" in one
    assert "bench.FlightError" in one
    records = (site.parent / "pages" / "api-record.md").read_text(encoding="utf-8")
    arrays = records.partition("## NavSolution\n")[2].partition("## ")[0]
    assert r"\[m/s\], n" in arrays


def test_the_first_page_is_what_it_is_how_to_install_and_an_example_with_its_output(site):
    text = (site.parent / "pages" / "index.md").read_text(encoding="utf-8")
    assert text.index("tests INS/GNSS navigation filters") < text.index("## Install")
    places = [
        text.index(part) for part in ("](figure-eight.png)", "bench run figure-eight", "✗ overconfident")
    ]
    assert places == sorted(places)


def test_every_picture_of_the_guide_is_shown_small_and_made_by_the_command():
    pictures = [*FOLDER.glob("*.png"), *(PACKAGE / "plugins").glob("*/*.png")]
    shown = {path.stem for path in pictures}
    assert shown == set(PICTURES)
    assert max(path.stat().st_size for path in pictures) <= MOST_BYTES
    for path in pictures:
        with Image.open(path) as image:
            assert re.fullmatch(r"bench \S+, commit \w+, \d{4}-\d\d-\d\d", image.info.get("Source", "")), path
    pages = [*find_pages().values(), FOLDER / "README.md", PACKAGE.parent / "README.md"]
    text = "".join(path.read_text() for path in pages)
    assert [name for name in sorted(shown) if f"{name}.png)" not in text] == []


def test_a_link_that_leads_nowhere_ends_the_build(tmp_path, monkeypatch):
    pages = tmp_path / "guide"
    pages.mkdir()
    for path in FOLDER.glob("*.md"):
        (pages / path.name).write_bytes(path.read_bytes())
    for path in FOLDER.glob("*.png"):
        (pages / path.name).write_bytes(path.read_bytes())
    with (pages / "faults.md").open("a") as page:
        page.write("\n[gone](no-such-page.md)\n")
    monkeypatch.setattr(docs_site, "FOLDER", pages)
    with pytest.raises(RuntimeError, match="no-such-page"):
        docs_site.build(tmp_path / "site", ["approach"])
