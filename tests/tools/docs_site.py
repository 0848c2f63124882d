"""Build the documentation as a site that needs no network: ``make docs``.

The guide, a page of all public names from their docstrings, and a picture of each shipped flight become
``site/``; `zensical` makes the pages. A link that leads nowhere ends the build.
"""

from __future__ import annotations

import re
import shutil
import subprocess
import sys
from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path

import numpy as np

import bench
from bench.cli.verbs.guide import FOLDER, find_pages
from bench.core.files.places import PACKAGE
from bench.core.mathematics import earth
from bench.core.records.findings import series
from bench.io.config import list_profiles
from bench.views.report import overview, page, svg
from tests.tools import api_pages
from tests.tools.api_pages import TOPICS

DATA = Path(__file__).parents[1] / "data" / "docs"
WORKER = "iframe-worker.js"
"""Lets the search run from a folder; the pages of zensical would load it from the network."""
_REMOTE = "https://unpkg.com/iframe-worker/shim"

_LIGHTBOX = re.compile(r'\w+\(\w+\("\.glightbox",e\)\),')
"""What loads a viewer of pictures from the network, whether a page has any or not."""

_CONFIG = """\
[project]
site_name = "bench"
site_description = "Where an INS/GNSS navigation filter is evaluated on realistic flights"
docs_dir = "pages"
site_dir = "site"
use_directory_urls = false
nav = [
{nav}
]
[project.theme]
font = false
[[project.theme.palette]]
media = "(prefers-color-scheme: light)"
scheme = "default"
[[project.theme.palette]]
media = "(prefers-color-scheme: dark)"
scheme = "slate"
[project.plugins.offline]
[project.plugins.search]
"""

_FOLDERS = re.compile(r"\]\((?:\.\./)+(?:\w+/)+(?=[\w-]+\.md\))")
"""Before a link to a page in another folder."""
_NAMED = re.compile(r"^```(\w+) (\S+)$", re.MULTILINE)
"""A fence with the name of a file."""
_PLAIN = re.compile(r"(```.*?^```|``.+?``|`[^`\n]+`)|(\[+[^]\[\n]*\]+)(?![(\[])", re.DOTALL | re.MULTILINE)


def build(folder: Path, profiles: Sequence[str] | None = None) -> Path:
    """Write the site into a folder and return that of its pages.

    Parameters
    ----------
    folder : Path
        What is in it is replaced.
    profiles : sequence of str, optional
        Those of the gallery; all that are shipped unless they are told.

    Raises
    ------
    RuntimeError
        If a page has a link that leads nowhere, or is missing.
    """
    shutil.rmtree(folder, ignore_errors=True)
    pages = folder / "pages"
    shutil.copytree(FOLDER, pages, ignore=shutil.ignore_patterns("README.md"))
    for path in (PACKAGE / "plugins").glob("*/*"):
        if path.suffix in (".md", ".png") and path.name != "README.md":
            shutil.copy(path, pages)
    for path in pages.glob("*.md"):
        path.write_text(_make_page(path), encoding="utf-8")
    (pages / "index.md").write_text(write_index(), encoding="utf-8")
    (pages / "gallery.md").write_text("\n".join(write_gallery(pages, profiles)), encoding="utf-8")
    for name, text in api_pages.write_pages().items():
        (pages / f"{name}.md").write_text(keep_brackets(text), encoding="utf-8")
    (folder / "zensical.toml").write_text(_CONFIG.format(nav="\n".join(_list_nav())), encoding="utf-8")
    done = subprocess.run(
        [Path(sys.executable).with_name("zensical"), "build", "--strict", "--config-file", "zensical.toml"],
        cwd=folder,
        capture_output=True,
        text=True,
        timeout=300,
    )
    if done.returncode:
        raise RuntimeError(re.sub(r"\x1b\[[\d;]*m", "", f"{done.stdout}\n{done.stderr}"))
    return _take_off_network(folder / "site")


def write_index() -> str:
    """Return the first page: what bench is, how to install it, the first run, and the list of pages."""
    text = (PACKAGE.parent / "README.md").read_text(encoding="utf-8")
    what, _, rest = text.partition("## Validation")
    validation = rest.partition("## Documentation")[0]
    pages = (FOLDER / "README.md").read_text(encoding="utf-8").partition("## Start")[2]
    titles = {name: f"{title[0].lower()}{title[1:]}" for name, (title, _) in TOPICS.items()}
    api = "".join(f"- [{name}]({name}.md): {title}\n" for name, title in titles.items())
    flights = "- [gallery](gallery.md): the flights\n"
    lists = f"## Start{pages.rstrip()}\n\n## Flights and Python API\n\n{flights}{api}"
    text = f"{what}## Validation{validation}\n# Pages\n\n{lists}".replace("](bench/guide/", "](")
    return keep_brackets(_FOLDERS.sub("](", text))


def _make_page(path: Path) -> str:
    """Return a page as it stands in one folder with all others; the name of a file is a title above it."""
    text = _NAMED.sub(r'```\1 title="\2"', path.read_text(encoding="utf-8"))
    return keep_brackets(_FOLDERS.sub("](", text))


def keep_brackets(text: str) -> str:
    """Return Markdown whose brackets outside code, such as those of units, are no links.

    Examples
    --------
    >>> keep_brackets("error [m] of `a[i]`, see [results](results.md)")
    'error \\\\[m\\\\] of `a[i]`, see [results](results.md)'
    """
    return _PLAIN.sub(lambda found: found[1] or re.sub(r"([][])", r"\\\1", found[2]), text)


def _list_nav() -> Iterator[str]:
    """Yield the entries of the navigation: the headings of the guide, below each the titles of its pages."""
    yield '  { "bench" = "index.md" },'
    for heading, entries in _GROUP.findall((FOLDER / "README.md").read_text(encoding="utf-8")):
        pages = (find_pages()[topic] for topic in _TOPIC.findall(entries))
        titles = (
            (path.stem, path.read_text(encoding="utf-8").partition("\n")[0].lstrip("# ")) for path in pages
        )
        rows = ", ".join(f'{{ "{title}" = "{name}.md" }}' for name, title in titles)
        yield f'  {{ "{heading}" = [{rows}] }},'
    yield '  { "Flights" = "gallery.md" },'
    rows = ", ".join(f'{{ "{title}" = "{name}.md" }}' for name, (title, _) in TOPICS.items())
    yield f'  {{ "Python API" = [{rows}] }},'


_GROUP = re.compile(r"^## (.+)\n\n((?:- .+\n)+)", re.MULTILINE)
_TOPIC = re.compile(r"^- \[([\w-]+)\]", re.MULTILINE)


def _take_off_network(site: Path) -> Path:
    (site / "404.html").unlink()  # of a server
    shutil.copy(DATA / WORKER, site / "assets" / WORKER)
    for path in site.rglob("*.html"):
        up = "../" * len(path.relative_to(site).parents[:-1])
        text = path.read_text(encoding="utf-8").replace(_REMOTE, f"{up}assets/{WORKER}")
        path.write_text(text, encoding="utf-8")
    (bundle,) = (site / "assets" / "javascripts").glob("bundle.*.js")
    script, found = _LIGHTBOX.subn("", bundle.read_text(encoding="utf-8"))
    if found != 1:
        raise RuntimeError(f"{bundle.name}: where it loads its viewer of pictures was found {found} times")
    bundle.write_text(script, encoding="utf-8")
    return site


# --- flights ------------------------------------------------------------------------------------------


def write_gallery(pages: Path, profiles: Sequence[str] | None) -> Iterator[str]:
    """Yield the lines of the page of the shipped flights, and write their pictures beside it."""
    (pages / "gallery").mkdir()
    yield "# Gallery\n"
    yield "The shipped flights from above; `bench run NAME` flies one.\n"
    for name in profiles or [entry.name for entry in list_profiles()]:
        yield f"## {name}\n"
        head = (PACKAGE / "profiles" / f"{name}.toml").read_text(encoding="utf-8").partition("\n\n")[0]
        yield keep_brackets(" ".join(_read_comment(head.splitlines())))
        yield f"\n![{name} from above](gallery/{name}.svg)\n"
        (pages / "gallery" / f"{name}.svg").write_text(_draw(name), encoding="utf-8")


def _read_comment(lines: Iterable[str]) -> Iterator[str]:
    return (line.removeprefix("#").strip() for line in lines if line.startswith("#"))


def _draw(name: str) -> str:
    truth = bench.fly(name)
    rows = slice(None, None, max(1, len(truth.t) // 4000))
    ground = earth.local_ned(np.asarray(truth.lla[rows]), truth.lla[0])[:, :2]
    instants = overview.name_instants(np.asarray(truth.t[rows]), ground)
    drawn = svg.draw_track([("truth", series.TRUTH, ground)], np.empty((0, 2)), instants=instants)
    head, _, body = drawn.partition(">")
    style = page.read_style()
    return f'{head} xmlns="http://www.w3.org/2000/svg" width="420"><style>{style}</style>{body}'


def main() -> None:
    folder = Path("build") / "docs"
    site = build(folder)
    print(f"Wrote {site}: open {site / 'index.html'}")


if __name__ == "__main__":
    main()
