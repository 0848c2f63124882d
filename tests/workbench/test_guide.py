"""Every command and every block of code in README.md and the guide runs, and their tables are complete."""

from __future__ import annotations

import contextlib
import gzip
import io
import json
import os
import re
import shlex
import shutil
import subprocess
import sys
import tomllib
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import click
import pytest
from rich.console import Console

import bench
from bench.cli.command_line import commands, main
from bench.cli.new_files.new_example import new_check
from bench.cli.verbs import guide
from bench.core.words.exceptions import EstimatorError
from bench.evaluation.metrics.run_metrics import METRICS
from bench.experiments.baselines.baseline_file import LEAST_DRAWS
from bench.io.config import read_profile
from bench.io.exports import FORMATS
from bench.navigation.built_in import BUILT_IN, load
from bench.navigation.estimator import RECORDS
from tests.tools.guide_pictures import name_source

ROOT = Path(__file__).parents[2]
PAGES = guide.find_pages()
ALL = {"README": ROOT / "README.md", **PAGES}

PARSED = {
    "view": "opens a window",
    "serve": "waits for a client",
    "stream": "sends for as long as the run lasted",
    "campaign": "takes minutes; its tests run it on a short flight",
    "report campaigns/figure-eight-20260101": "needs a campaign; its tests write the report of a short one",
    "report --figures": "takes seconds; its tests write the figures of a short one",
    "compare": "needs more results; its tests compare short ones",
    "card": "takes minutes; its tests run it on a short flight",
    "study outages": "takes minutes; its tests run it on one unit",
    "study sensors": "takes minutes; its tests run it on three units",
    "study sensitivity": "takes minutes; its tests run it with two values",
    "study budget": "takes minutes; its tests run it on a short flight",
    "study bound": "takes a quarter of a minute; its tests run it on a short flight",
    "study closed-loop": "takes minutes; its tests fly a short one",
    "study rnp": "takes minutes; its tests fly a few",
    "study mechanizations": "takes a minute; the tests of its plug-in compute parts",
    "study register": "takes a minute; the tests of its plug-in compute rows",
    "tune": "takes minutes; its tests run it on a short flight",
    "check": "runs every profile that has limits",
    "make": "sets up an environment",
}
"""Commands that are only parsed -> why."""

TUTORIALS = ("README", "first-run", "first-ekf", "choose-imu", "evaluate-log", "filter-in-cpp", "ci-check")
"""Pages of which every command runs, and whose outputs are compared."""

FIRST = ["bench", "run", "figure-eight"]
"""Command that runs once for all pages."""

CAUSES = "causes"
"""The page that shows the search for causes, dozens of runs of a filter; it is left out elsewhere."""

CLONE = {"log-format": "tests", "autopilots": "tests", "evaluate-log": "tests"}
"""Pages that show files of the repository -> the folder that has them."""
GNSS = ROOT / "tests" / "data" / "gnss"
RINEX = {"site.rnx": "ESBC00DNK_2020177_GR_360s.rnx.gz", "brdc.rnx": "ESBC00DNK_2020177_GR_MN.rnx.gz"}
"""Files that a reader brings -> what stands in for them."""


@dataclass(frozen=True)
class Block:
    """A fenced block: what follows its fence, its text, and the line it begins at."""

    kind: str
    name: str
    text: str
    line: int


def blocks(page: Path) -> Iterator[Block]:
    text = page.read_text(encoding="utf-8")
    assert text.count("```") % 2 == 0, f"{page.name}: a fence is left open"
    for found in re.finditer(r"^```(\w*) ?(\S*)\n(.*?)^```$", text, re.DOTALL | re.MULTILINE):
        yield Block(*found.groups(), text[: found.start()].count("\n") + 1)


def command_lines(block: Block) -> Iterator[tuple[list[str], int]]:
    """The words of each command, and the exit status that its comment says."""
    for line in block.text.replace("\\\n", "").splitlines():
        words = shlex.split(line.replace("$PWD", str(Path.cwd())), comments=True)
        if words:
            said = re.search(r"# status (\d+)$", line)
            yield words, int(said[1]) if said else 0


def parsed(arguments: list[str]) -> click.Context:
    """The context of a bench command, with all its options checked."""
    name, verb, rest = commands.resolve_command(click.Context(commands), arguments)
    assert verb is not None
    assert name is not None
    return verb.make_context(name, rest, parent=click.Context(commands, info_name="bench"))


def is_parsed_only(words: list[str]) -> bool:
    return any(all(part in words for part in known.split()) for known in PARSED)


# --- everything runs ------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def figure_eight(tmp_path_factory) -> tuple[Path, str, str]:
    """The results of figure-eight, the cache with its truth, and what the command printed."""
    folder = tmp_path_factory.mktemp("first")
    cache = str(tmp_path_factory.mktemp("cache"))
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(folder)
        patch.setenv("BENCH_CACHE", cache)
        patch.setenv("COLUMNS", "80")
        with contextlib.redirect_stdout(io.StringIO()) as printed:
            assert main(FIRST[1:]) == 0
    return folder / "runs" / "figure-eight-20260101", cache, printed.getvalue()


def test_recording_and_report_of_ten_minutes_are_as_small_as_promised(figure_eight):
    folder, *_ = figure_eight
    summary = json.loads((folder / "result.json").read_text(encoding="utf-8"))
    assert len(summary["metrics"]) == 3
    assert summary["profile"]["duration_s"] == 600.0
    # `make perf` holds it to 15 MB; another version of rerun may pack it otherwise
    assert (folder / "flight.rrd").stat().st_size <= 19e6
    assert (folder / "report.html").stat().st_size <= 2e6


@pytest.fixture
def own_modules(tmp_path) -> Iterator[None]:
    """Forget the modules that a page wrote: the next page may write others of their names."""
    yield
    for name, module in list(sys.modules.items()):
        if str(getattr(module, "__file__", "")).startswith(str(tmp_path)):
            del sys.modules[name]


@pytest.mark.usefixtures("own_modules")
@pytest.mark.parametrize("page", ALL)
def test_every_block_of_a_page_runs_in_its_order(page, figure_eight, tmp_path, monkeypatch, capfd):
    results, cache, first = figure_eight
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("COLUMNS", "80")
    monkeypatch.setenv("BENCH_CACHE", cache)
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.setattr(new_check, "__kwdefaults__", {"draws": LEAST_DRAWS})
    Path("runs").mkdir()
    (Path("runs") / results.name).symlink_to(results)
    if page in CLONE:
        Path(CLONE[page]).symlink_to(ROOT / CLONE[page])
    for name, packed in RINEX.items():
        Path(name).write_bytes(gzip.decompress((GNSS / packed).read_bytes()))
    names: dict[str, Any] = {"__name__": page}
    outputs: list[str] = []
    shown: str | None = None  # by the block before
    end = 0
    for block in blocks(ALL[page]):
        where = f"{ALL[page].name}:{block.line}"
        if block.name:
            Path(block.name).write_text(block.text)
        if block.kind == "sh":
            shown = ""
            for words, status in command_lines(block):
                if words == FIRST:
                    outputs.append(first)
                    shown = f"{shown or ''}{first}"
                    continue
                if words[:2] == ["bench", "run"] and page not in (CAUSES, *TUTORIALS):
                    words.append("--no-causes")
                ran = obey(words, where, capfd, status, every=page in TUTORIALS)
                outputs.append(capfd.readouterr().out)
                shown = f"{shown}{outputs[-1]}" if ran and shown is not None else None
        elif block.kind == "python" and not block.name:
            exec(compile(block.text, where, "exec"), names)
            shown = capfd.readouterr().out
        elif block.kind == "toml":
            tables = tomllib.loads(block.text)
            if not block.name:
                assert page in CLONE, f"{where}: name the file that this is"
                check_real_log(tables)
            elif "source" in tables:
                read_profile("figure-eight", {"sensors.imu": str(tmp_path / block.name)})
        elif block.kind == "text" and outputs and page in TUTORIALS:
            compare_output(ALL[page], block, outputs[-1])
        elif block.kind == "text" and shown and block.line == end + 1:
            missing = find_missing(block.text, shown)
            assert missing == "", f"{where}: nothing prints {missing!r}, but:\n{shown}"
            shown = None
        else:
            assert block.kind == "text" or block.name, f"{where}: a block of {block.kind!r} is not run"
        end = block.line + block.text.count("\n") + 2


def compare_output(page: Path, block: Block, printed: str) -> None:
    """Compare an output with the one on the page; `make guide` writes it there instead."""
    printed = "\n".join(line.rstrip() for line in printed.strip("\n").splitlines()) + "\n"
    if os.environ.get("BENCH_WRITE_GUIDE") and not is_same_output(block.text, printed):
        lines = page.read_text(encoding="utf-8").split("\n")
        start = WRITTEN.get(page.name, 0) + block.line  # the lines above it have been written, too
        lines[start : start + block.text.count("\n")] = printed.rstrip("\n").split("\n")
        page.write_text(stamp("\n".join(lines)), encoding="utf-8")
        WRITTEN[page.name] = WRITTEN.get(page.name, 0) + printed.count("\n") - block.text.count("\n")
        return
    assert is_same_output(block.text, printed), f"{page.name}:{block.line}: make guide writes\n{printed}"


STAMP = re.compile(r"\n<!-- output of bench \S+, commit \w+, \d{4}-\d\d-\d\d -->\n\Z")
"""Last line of a page with outputs: what has written the newest of them."""


def stamp(text: str) -> str:
    """Return a page whose last line names version and commit of bench, and the day."""
    return STAMP.sub("", text.rstrip("\n") + "\n").rstrip("\n") + f"\n\n<!-- output of {name_source()} -->\n"


@pytest.mark.parametrize("page", TUTORIALS)
def test_a_page_with_outputs_is_dated_with_the_commit_that_wrote_them(page):
    assert STAMP.search(ALL[page].read_text(encoding="utf-8")), "make guide writes it"


WRITTEN: dict[str, int] = {}
"""Page -> by how many lines its outputs have grown."""


def is_same_output(shown: str, printed: str) -> bool:
    """Whether two outputs have the same words and, within 1 %, the same numbers; times are left out."""
    first, second = (re.sub(r"\d+(\.\d+)? s\b(?=[)])", "T s", text).split() for text in (shown, printed))
    number = re.compile(r"-?\d+(\.\d+)?(e[-+]\d+)?")

    def alike(one: str, other: str) -> bool:
        if number.sub("#", one) != number.sub("#", other):
            return False
        pairs = zip(number.finditer(one), number.finditer(other), strict=True)
        return all(float(a[0]) == pytest.approx(float(b[0]), rel=0.01) for a, b in pairs)

    return len(first) == len(second) and all(map(alike, first, second))


def find_missing(shown: str, printed: str) -> str:
    """Return the first line of a shortened output that is not printed after the one before; empty if none."""
    rest = iter(printed.splitlines())
    return next(
        (
            one
            for one in shown.splitlines()
            if one.strip(" .") and not any(is_same_output(one, other) for other in rest)
        ),
        "",
    )


def test_a_shortened_output_has_lines_of_the_whole_one_in_their_order():
    printed = "a 1.00\nb 2.00\nc 3.00\n"
    assert find_missing("a 1.00\n...\nc 3.01\n", printed) == ""
    assert find_missing("c 3.00\na 1.00\n", printed) == "a 1.00"
    assert find_missing("b 2.1\n", printed) == "b 2.1"


def test_outputs_differ_by_words_and_by_more_than_a_percent():
    shown = "loose-15  13.7 m  overconfident\n\nResults  runs/a (3.0 s)\n"
    assert is_same_output(shown, shown.replace("3.0 s", "41 s").replace("13.7", "13.8"))
    assert not is_same_output(shown, shown.replace("13.7", "14.7"))
    assert not is_same_output(shown, shown.replace("overconfident", "consistent"))
    assert not is_same_output(shown, shown.replace("13.7 m", ""))


def check_real_log(tables: dict[str, Any]) -> None:
    """It is the log of the repository; what has the default may be left out there."""
    file = tomllib.loads((ROOT / "tests" / "logs" / "drive.toml").read_text())
    del tables["evaluation"]["withhold"], file["title"]
    assert tables == file


def obey(words: list[str], where: str, capfd, wanted: int, *, every: bool) -> bool:
    """Run one command, or parse it if it is of those that are only parsed; return whether it ran."""
    if words[0] == "g++":
        if shutil.which("g++") is None:
            pytest.skip("no C++ compiler here")
        subprocess.run(words, check=True)
        return True
    if words[0] == "make":
        assert re.search(rf"^{words[1]}:", (ROOT / "Makefile").read_text(), re.MULTILINE), where
        return False
    assert words[0] == "bench", f"{where}: {words[0]} is not run by this test"
    parsed(words[1:])
    if every or not is_parsed_only(words):
        status = main(words[1:])
        assert status == wanted, f"{where}: {shlex.join(words)}\n{''.join(capfd.readouterr())}"
        return True
    return False


def test_the_files_that_toml_blocks_describe_are_used_by_a_command():
    for page, path in ALL.items():
        used = [
            word for block in blocks(path) if block.kind == "sh" for word in shlex.split(block.text, True)
        ]
        for block in blocks(path):
            if block.name:
                stem = Path(block.name).stem
                assert any(stem in word for word in used), f"{page}: {block.name} is not used"


@pytest.mark.parametrize("page", ALL)
def test_commands_within_sentences_exist(page):
    text = re.sub(r"^```.*?^```$", "", ALL[page].read_text(), flags=re.DOTALL | re.MULTILINE)
    for span in re.findall(r"`(bench [^`]+)`", text):
        verb, *rest = shlex.split(span)[1:]
        known = commands.get_command(None, verb)
        assert known is not None or verb in ("TOPIC", "VERB", "--help"), f"{page}: {span}"
        if isinstance(known, click.Group) and rest and not rest[0].startswith("-") and rest[0] != "NAME":
            known = known.get_command(click.Context(known), rest[0])
        params = known.params if known else ()
        options = {name for param in params for name in (*param.opts, *param.secondary_opts)} | {"--help"}
        assert {word for word in rest if word.startswith("-")} <= options, f"{page}: {span}"
    for span in re.findall(r"`make (\w+)`", text):
        assert f"\n{span}:" in (ROOT / "Makefile").read_text(), f"{page}: make {span}"
    for span in re.findall(r"`pytest ([^`]+)`", text):
        assert (ROOT / span).is_file(), f"{page}: {span}"


@pytest.mark.parametrize("page", ALL)
def test_paths_and_links_exist(page):
    text = ALL[page].read_text()
    for span in re.findall(r"`((?:bench|tests|aircraft)/[\w./-]+)`", text):
        assert (ROOT / span).exists(), f"{page}: {span}"
    for target in re.findall(r"\[[^]]*\]\(([^)\s]+)\)", text):
        if not target.startswith("http"):
            assert (ALL[page].parent / target).is_file(), f"{page}: {target}"


# --- tables are complete --------------------------------------------------------------------------------


def said(page: str) -> set[str]:
    """Every word that stands in code on a page."""
    spans = re.findall(r"`([^`\n]+)`", PAGES[page].read_text())
    return {word for span in spans for word in re.findall(r"[\w{}-]+", span)}


def known(capsys, what: str, *, verb: str = "fly", text: str = "", **tables: object) -> set[str]:
    """What bench says it knows of a file with tables that hold something it does not."""
    path = Path(f"unknown-{verb}.toml")
    path.write_text(text + "\n".join(f"{name} = {toml(table)}" for name, table in tables.items()))
    assert main([verb, str(path)]) == 2
    err = capsys.readouterr().err
    found = re.search(rf"{UNKNOWN}.*\n  known {what}: (.+)", err)
    assert found, err
    return set(found[1].split(", "))


UNKNOWN = "unheard-of"


def toml(value: object) -> str:
    if isinstance(value, dict):
        return f"{{ {', '.join(f'{key} = {toml(inner)}' for key, inner in value.items())} }}"
    return f"[{', '.join(map(toml, value))}]" if isinstance(value, list) else json.dumps(value)


WRONG = {UNKNOWN: 1}


@pytest.fixture
def empty_folder(tmp_path, monkeypatch) -> None:
    monkeypatch.chdir(tmp_path)


@pytest.mark.usefixtures("empty_folder")
def test_the_page_of_profiles_names_every_key_and_leg(capsys):
    keys = known(capsys, "keys", **WRONG)
    for table in ("start", "runway", "wind", "sensors", "initial_error_sd", "alignment", "evaluation"):
        keys |= known(capsys, "keys", **{table: WRONG})
    keys |= known(capsys, "keys", sensors={"assumed": WRONG})
    for table in ("gust", "gnss_outage", "estimator"):
        keys |= known(capsys, "keys", **{table: [WRONG]})
    keys |= known(capsys, "keys", script="c1723", antenna=WRONG)
    kinds = known(capsys, "kinds", leg=[{"kind": UNKNOWN}])
    for kind in kinds:
        keys |= known(capsys, "keys", leg=[{"kind": kind} | WRONG])
    assert len(kinds) >= 20
    in_blocks = {"leg", "kind", "assumed", "label", "start_s"}
    assert (keys | kinds) - in_blocks <= said("profiles") | {"gnss_outage", "fault"}


@pytest.mark.usefixtures("empty_folder")
def test_the_page_of_aircraft_names_the_keys_of_scripts(capsys):
    keys = known(capsys, "keys", script="c1723", **WRONG) - known(capsys, "keys", **WRONG)
    assert keys
    assert keys <= said("aircraft")


@pytest.mark.usefixtures("empty_folder")
def test_the_page_of_faults_names_every_key_and_kind(capsys):
    kinds = known(capsys, "kinds", fault=[{"kind": UNKNOWN}])
    keys = {key for kind in kinds for key in known(capsys, "keys", fault=[{"kind": kind} | WRONG])}
    assert len(kinds) >= 14
    assert kinds | keys <= said("faults")


@pytest.mark.usefixtures("empty_folder")
def test_the_page_of_logs_names_every_key_and_format(capsys):
    keys = known(capsys, "keys", verb="navigate", **WRONG)
    for table in ("imu", "gnss", "baro", "alignment", "evaluation"):
        keys |= known(capsys, "keys", verb="navigate", **{table: WRONG})
    assert keys <= said("log-format")
    assert main(["navigate", "unknown-navigate.toml"]) == 2
    Path("unknown-navigate.toml").write_text('[imu]\nfile = "a"\nformat = "?"')
    assert main(["navigate", "unknown-navigate.toml"]) == 2
    listed = re.search(r"format = '\?' must be (.+)", capsys.readouterr().err)
    assert listed
    formats = set(re.findall(r"'([a-z-]+)'", listed[1]))
    assert len(formats) >= 7
    assert formats <= said("log-format")


@pytest.mark.usefixtures("empty_folder")
def test_the_page_of_sensors_names_every_figure(capsys):
    keys = set()
    for kind in known(capsys, "keys", sensors=WRONG) - {"assumed", "qnh_hpa"}:
        asked = {"imu": "stim300"} | {kind: "sheet.toml"}
        Path("sheet.toml").write_text(f'source = ""\n{UNKNOWN} = 1')
        tables = known(capsys, "keys", script="c1723", sensors=asked) - SHEET
        for table in tables:
            Path("sheet.toml").write_text(f'source = ""\n[{table}]\n{UNKNOWN} = 1')
            keys |= {table, *known(capsys, "keys", script="c1723", sensors=asked)}
    assert len(keys) > 120
    assert keys <= said("sensors")


SHEET = {"title", "class", "confidence", "source", "sources", "assumed"}
"""Keys that every datasheet has."""


def test_the_page_of_estimators_names_every_one_and_its_options():
    assert set(BUILT_IN) <= said("estimators")
    for name in BUILT_IN:
        with pytest.raises(EstimatorError, match="known options: ") as caught:
            load(name, {UNKNOWN: 1})
        options = set(str(caught.value).partition("known options: ")[2].split(", "))
        assert len(options) >= 3
        assert options <= said("estimators"), name


def test_other_pages_name_every_format_record_and_metric():
    assert set(FORMATS) <= said("other-tools")
    assert set(RECORDS) <= said("filter-protocol")
    assert set(bench.__all__) - {"__version__"} <= said("python")
    assert {metric.name for metric in METRICS} <= said("results")


# --- README -----------------------------------------------------------------------------------------------


def test_readme_is_short():
    assert len(ALL["README"].read_text().split()) <= 900


CONTRIBUTING = ROOT / "CONTRIBUTING.md"


def test_the_tree_of_the_page_for_contributors_is_true():
    text = CONTRIBUTING.read_text()
    tree = text[text.index("## The tree") :].split("```")[1]
    named, folder = set(), ""
    for line in tree.splitlines()[1:]:
        indent, entry = len(line) - len(line.lstrip()), line[:26].strip()
        folder = folder if indent else entry.split()[0] if entry.endswith("/") else ""
        named |= {(folder if indent else "") + word for word in entry.split()}
    for path in named:
        pattern = re.sub(r"<\w+>", "*", path)
        assert list(ROOT.glob(pattern.rstrip("/"))), f"{path} is not there"
    for path in (ROOT / "bench").iterdir():
        name = f"bench/{path.name}{'/' if path.is_dir() else ''}"
        assert name in named or path.name in ("__pycache__", "py.typed", "aircraft"), f"{name} is not named"


def test_the_floors_of_the_page_for_contributors_are_those_that_are_checked():
    text = CONTRIBUTING.read_text()
    written = re.search(r"```text\n(plugins > .*?)```", text, re.DOTALL)
    assert written is not None
    contracts = tomllib.loads((ROOT / "pyproject.toml").read_text())["tool"]["importlinter"]["contracts"]
    floors = [set(re.split(r"\s+[|:]\s+", floor.strip())) for floor in written[1].split(">")]
    assert floors == [set(re.split(r" [|:] ", floor)) for floor in contracts[0]["layers"]]


# --- bench guide -------------------------------------------------------------------------------------------


def test_the_list_has_every_page_with_a_line(capsys):
    assert set(guide.read_topics()) == set(PAGES)
    assert main(["guide"]) == 0
    lines = capsys.readouterr().out.splitlines()
    for topic, about in guide.read_topics().items():
        assert any(line.split() == [topic, *about.split()] for line in lines), topic
    assert max(map(len, lines)) <= 80


def test_the_guide_needs_no_numbers(tmp_path):
    code = (
        "import sys; from bench.cli.command_line import main; main(['guide', 'faults']); print(*sys.modules)"
    )
    env = os.environ | {"PYTHONPATH": str(ROOT)}
    done = subprocess.run([sys.executable, "-c", code], cwd=tmp_path, env=env, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    loaded = set(done.stdout.splitlines()[-1].split())
    assert "bench.cli.verbs.guide" in loaded
    assert not loaded & {"numpy", "pydantic", "numba", "pyarrow", "scipy"}


@pytest.mark.parametrize("topic", PAGES)
def test_a_topic_is_plain_markdown_where_there_is_no_terminal(topic, capsys):
    assert main(["guide", topic]) == 0
    assert capsys.readouterr().out == PAGES[topic].read_text()


@pytest.mark.parametrize("topic", PAGES)
def test_a_topic_is_rendered_on_a_terminal(topic, monkeypatch):
    shown: list[str] = []
    monkeypatch.setattr(guide.pydoc, "pager", shown.append)
    guide.show_topic(topic, Console(file=io.StringIO(), force_terminal=True, width=80))
    (text,) = shown
    plain = re.sub(r"\x1b\[[\d;]*m", "", text)
    assert text != plain
    assert not re.search(r"^```|^#|\]\(|<!--|…", plain, re.MULTILINE)
    assert max(map(len, plain.splitlines())) <= 80


@pytest.mark.parametrize(
    ("topic", "hint"), [("profile", ". Did you mean 'profiles'?"), ("xyzzy", ""), ("../README", "")]
)
def test_an_unknown_topic_is_told_with_all_of_them(topic, hint, capsys):
    assert main(["guide", topic]) == 2
    out, err = capsys.readouterr()
    assert out == ""
    known = ", ".join(sorted(guide.read_topics()))
    assert err == f"error: no topic {topic!r}{hint}\n  known topics: {known}\n"
