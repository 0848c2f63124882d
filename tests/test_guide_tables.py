"""The tables of the guide are what the code declares, and ``make guide`` writes them."""

from __future__ import annotations

from typing import Annotated, Literal

import pytest
from pydantic import AfterValidator, BaseModel

from bench.cli.verbs.guide import find_pages
from bench.core.records.fields import declared, figure
from bench.core.words.exceptions import ConfigError
from bench.navigation.options import Limit
from tests.tools import guide_tables
from tests.tools.guide_tables import rewrite_page


@pytest.mark.parametrize("topic", find_pages())
def test_the_tables_of_a_page_are_what_the_code_declares(topic):
    text = find_pages()[topic].read_text(encoding="utf-8")
    assert rewrite_page(topic, text) == text, "the code declares something else: make guide"


class Ship(BaseModel):
    """A declaration with every kind of key."""

    flag: bool = False
    """Whether it flies."""
    grade: Literal["a", "b"] = "a"
    """How good
    it is."""
    sd: Annotated[float, AfterValidator(Limit(lambda x: x > 0, "positive"))]
    """How well it is known | or not [m]."""
    place: tuple[float, float, float] | None = None
    """Where it is. Default: at the quay."""
    bare: int = 0


def test_a_table_has_limits_defaults_and_words_of_its_keys():
    keys = guide_tables.list_keys(Ship, ["flag", "grade", "sd", "place"])
    assert list(guide_tables.write_keys("key", keys)) == [
        "| key | meaning | allowed | default |",
        "|---|---|---|---|",
        "| `flag` | Whether it flies |  | `false` |",
        '| `grade` | How good it is | `"a"`, `"b"` | `"a"` |',
        "| `sd` | How well it is known \\| or not [m] | positive | required |",
        "| `place` | Where it is | 3 numbers | at the quay |",
        "",
    ]


@declared
class Balloon:
    """A spec with every kind of figure."""

    volume: float = figure("m", reported=True)
    """What it holds [m^3]; without its basket."""
    leak: float = figure("k", -1, 2.5, default=0.5)
    """How fast it falls [K]."""
    rise: float = figure("km", default=0.0, reciprocal=True)
    """How far."""


@declared
class Stone:
    """A spec whose figure nobody has described."""

    mass: float = figure("g")


def test_a_figure_has_its_key_and_limits_in_the_unit_of_the_file_and_no_other_unit():
    assert guide_tables.list_figures(Balloon) == [
        ("`volume_m`", "What it holds; without its basket", "above 0", "required"),
        ("`leak_k`", "How fast it falls", "-1 to 2.5", "`0.5`"),
        ("`rise_km`", "How far", "above 0", ""),
    ]


@pytest.mark.parametrize(
    ("name", "list_them"),
    [
        ("Ship.bare", lambda: guide_tables.list_keys(Ship)),
        ("Stone.mass", lambda: guide_tables.list_figures(Stone)),
    ],
)
def test_a_key_without_words_is_named(name, list_them):
    with pytest.raises(ConfigError, match=rf"^{name} has no words: write what it means below it$"):
        list_them()


PAGE = "Before.\n\n<!-- make guide writes: ships -->\n| old |\n<!-- to here -->\n\nAfter.\n"


@pytest.fixture
def folder(tmp_path, monkeypatch):
    pages = {name: tmp_path / f"{name}.md" for name in ("land", "sea")}
    monkeypatch.setattr(guide_tables, "find_pages", lambda: pages)
    monkeypatch.setattr(guide_tables, "TABLES", {"sea": {"ships": lambda: iter(["| new |", ""])}})
    (tmp_path / "land.md").write_text("No tables.\n")
    return tmp_path


def test_the_command_writes_between_the_comments_alone(folder, capsys):
    (folder / "sea.md").write_text(PAGE)
    assert guide_tables.main() == 0
    assert (folder / "sea.md").read_text() == PAGE.replace("old", "new")
    assert (folder / "land.md").read_text() == "No tables.\n"
    assert capsys.readouterr().out == "sea.md is new\n"
    assert guide_tables.main() == 0
    assert capsys.readouterr().out == ""


@pytest.mark.parametrize("page", ["No place.\n", PAGE.replace("ships", "boats"), PAGE + PAGE])
def test_a_table_without_its_place_is_an_error_and_nothing_is_written(page, folder, capsys):
    (folder / "sea.md").write_text(page)
    assert guide_tables.main() == 2
    assert (folder / "sea.md").read_text() == page
    assert "error: sea.md: has places for [" in capsys.readouterr().err
