"""The report shows what the result holds, needs nothing but itself, and runs nothing that a file brings."""

import base64
import hashlib
import io
import re
import subprocess
from dataclasses import replace
from html.parser import HTMLParser
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
import rerun_cli
from rich.console import Console

import bench
from bench.cli.command_line import main
from bench.cli.verbs.printing import print_table
from bench.core.files.places import PACKAGE
from bench.core.records.findings import FindingTable
from bench.core.records.findings.series import Plot, Series, draw_three_sigma
from bench.core.words.exceptions import ConfigError
from bench.core.words.notebook import ShownFigure, ShownText
from bench.evaluation.metrics.key_figures import list_key_figures
from bench.evaluation.metrics.metric_words import format_metric, group_metrics
from bench.views.recording import write_recording
from bench.views.report import page, svg, writing
from bench.views.report.forest import RatioRow, draw_ratios
from tests.test_api import SHORT

HOSTILE = "<script>alert(1)</script>\u202e\x1b[2J"


class Outline(HTMLParser):
    """Tags with their attributes, and the texts of scripts and table cells."""

    def __init__(self, text):
        super().__init__()
        self.tags, self.scripts, self.open = [], [], ""
        self.feed(text)

    def handle_starttag(self, tag, attrs):
        self.open = tag
        self.tags.append((tag, dict(attrs)))

    def handle_data(self, data):
        if self.open == "script":
            self.scripts.append(data)

    def handle_endtag(self, tag):
        self.open = ""


@pytest.fixture(scope="module")
def result():
    outage = {**SHORT, "gnss_outage": [{"start_s": 10.0, "duration_s": 5.0}]}
    profile = bench.read_profile("figure-eight", outage, seed=3, estimators=["loose-15", "free-inertial"])
    return bench.run(profile)


@pytest.fixture(scope="module")
def text(result):
    return page.make_page("short", result)


def test_a_recording_made_of_a_folder_is_that_of_the_run(result, tmp_path, capsys):
    folder = bench.write_result(result, tmp_path / "flight", report=False)
    first = (folder / "flight.rrd").read_bytes()
    (folder / "flight.rrd").unlink()
    assert main(["record", str(folder)]) == 0
    assert f"Next: bench view {folder}" in capsys.readouterr().out
    both = tmp_path / "first.rrd"
    both.write_bytes(first)
    tool = Path(rerun_cli.__file__).parent / "rerun"
    compared = subprocess.run([tool, "rrd", "compare", both, folder / "flight.rrd"], capture_output=True)
    assert compared.returncode == 0, compared.stderr
    (tmp_path / "mine.rrd").write_text("not a recording")
    with pytest.raises(ConfigError, match=r"mine.rrd: not replaced, it is not a recording"):
        write_recording(folder, tmp_path / "mine.rrd")
    with pytest.raises(ConfigError, match=r"a recording is an .rrd file"):
        write_recording(folder, tmp_path / "mine.txt")


def test_the_page_needs_no_other_file_and_allows_its_own_script_only(text):
    outline = Outline(text)
    links = [values.get(name) for _, values in outline.tags for name in ("src", "href", "action", "data")]
    assert {link[0] for link in links if link} == {"#"}
    assert "url(" not in text
    assert "@import" not in text
    policy = next(values["content"] for tag, values in outline.tags if values.get("http-equiv"))
    (script,) = outline.scripts
    digest = base64.b64encode(hashlib.sha256(script.encode()).digest()).decode()
    assert policy == f"default-src 'none'; style-src 'unsafe-inline'; script-src 'sha256-{digest}'"


def test_every_line_and_area_has_a_style(text):
    """Without a rule for its class a path is a black area, as between the ends of an outage."""
    style, _, body = text.partition("<body")
    drawn = re.findall(r"<(?:path|rect|circle) [^>]*class=\"([^\"]+)\"", body)
    assert "segment outage" in drawn
    rules = set(re.findall(r"\.([a-zA-Z][\w-]*)", style))
    assert {name.split()[0] for name in drawn} <= rules


def test_headings_are_in_order_and_every_picture_is_described(text):
    outline = Outline(text)
    levels = [int(tag[1]) for tag, _ in outline.tags if re.fullmatch("h[1-6]", tag)]
    assert levels[0] == 1
    assert levels.count(1) == 1
    assert all(after <= before + 1 for before, after in pairwise(levels))
    pictures = [v for tag, v in outline.tags if tag == "svg" and v.get("class") in ("plot", "track")]
    assert len(pictures) > 30
    assert all(v["role"] == "img" and len(v["aria-label"]) > 10 for v in pictures)


def test_verdicts_and_figures_are_those_of_the_result(result, text):
    table = text[text.index("<table") : text.index("</table>")]
    rows = re.findall(r'<th scope="row" title="(\w+): [^>]*>[^<]+</th>(.*?)</tr>', table, re.S)
    groups = group_metrics(list_key_figures(result.metrics))
    assert [name for name, _ in rows] == [name for group in groups.values() for name in group]
    headings = re.findall(r'<th scope="rowgroup" colspan="3">([^<]+)</th>', table)
    assert headings == list(groups)
    assert len(headings) > 2
    for name, cells in rows:
        found = re.findall(r"<td([^>]*)>([^ <]+)", cells)
        assert [value for _, value in found] == [
            format_metric(name, v.get(name)) for v in result.metrics.values()
        ]
        marked = [attribute.strip() == 'class="outside"' for attribute, _ in found]
        assert marked == [name in values["outside"] for values in result.metrics.values()]
    for values in result.metrics.values():
        assert values["verdict_text"] in text


def test_the_same_result_gives_the_same_page(result, text):
    assert page.make_page("short", result) == text


def read_points(path):
    """Return the points of path data, in steps."""
    numbers = np.array(re.findall(r"-?\d+", path), float).reshape(-1, 2)
    return np.cumsum(numbers, axis=0)


def draw_line(t, values, limits):
    series = Series(
        "value", t, np.column_stack([values, *limits]), ("v", "", ""), ((1, 2, 3),) * 3, (1.0,) * 3
    )
    drawing = svg.draw(Plot(("p",), "p", (series,)), (t[0], t[-1]))
    low, high = Plot(("p",), "p", (series,)).limits()
    data = re.search(r'class="line" d="([^"]+)"', drawing).group(1)
    x, y = read_points(data).T
    height = float(re.search(r'viewBox="0 0 \d+ (\d+)" preserve', drawing).group(1))
    return x, high - y / height * (high - low), (high - low) / height


def test_a_spike_of_one_epoch_among_100000_is_seen():
    t = np.linspace(0.0, 1000.0, 100_001)
    values = 0.1 * np.sin(t)
    values[61_803] = 5.0
    x, y, step = draw_line(t, values, [np.full(len(t), edge) for edge in (-6.0, 6.0)])
    assert y.max() == pytest.approx(5.0, abs=step)
    assert y.min() == pytest.approx(-0.1, abs=step)
    area = svg.WIDTH - 52 - 14
    assert x[y.argmax()] / 10 == pytest.approx(0.61803 * area, abs=1.0)
    assert len(x) < 2.1 * area


def test_a_line_passes_through_its_points_to_a_fifth_of_a_pixel():
    t = np.linspace(0.0, 10.0, 101)
    values = np.sin(t) + 0.2 * np.sin(5 * t)
    x, y, step = draw_line(t, values, [np.full(len(t), edge) for edge in (-2.0, 2.0)])
    at = x / x.max() * 10.0
    assert (
        np.abs(np.interp(t, at, y) - values).max() <= 5 * step
    )  # left out points lie 0.2 pixels off at most


def test_a_band_holds_its_edges_and_ends_where_they_are_unknown():
    t = np.arange(0.0, 100.0)
    sd = 1.0 + 0.01 * t
    sd[40:60] = np.nan
    series = draw_three_sigma("error", t, np.zeros(100), sd, "error", (1, 2, 3))
    drawing = svg.draw(Plot(("p",), "p", (series,)), (0.0, 99.0))
    (data,) = re.findall(r'class="band" d="([^"]+)"', drawing)
    assert data.count("M") == data.count("z") == 2
    columns = [
        read_points(part.split("L")[0])[:, 0] / 10 / (svg.WIDTH - 66) * 99 for part in data.split("M")[1:]
    ]
    assert [(round(x.min()), round(x.max())) for x in columns] == [(0, 39), (60, 99)]


def test_a_title_from_a_stranger_is_text(result):
    profile = {**result.profile, "title": HOSTILE, "aircraft": HOSTILE}
    metrics = {HOSTILE: dict(result.metrics["loose-15"], verdict_text=HOSTILE, unmodeled=[HOSTILE])}
    solutions = {HOSTILE: result.solutions["loose-15"]}
    errors = {HOSTILE: result.errors["loose-15"]}
    text = page.make_page(
        HOSTILE, replace(result, profile=profile, metrics=metrics, solutions=solutions, errors=errors)
    )
    assert text.count("<script>") == 1
    assert "alert(1)" in text
    assert "\x1b" not in text
    assert "\u202e" not in text


def test_run_writes_a_report_and_the_verb_writes_it_again(result, tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    folder = bench.write_result(result, "runs/short", recording=False)
    first = (folder / "report.html").read_text(encoding="utf-8")
    assert main(["report", "runs/short"]) == 0
    again = (folder / "report.html").read_text(encoding="utf-8")
    assert svg_of(first) == svg_of(again)
    bench.write_result(
        result, folder, recording=False, report=False, force=True
    )  # the report was the bench's own
    assert not (folder / "report.html").exists()
    assert main(["report", "runs"]) == 0
    index = (tmp_path / "runs/index.html").read_text(encoding="utf-8")
    assert 'href="short/report.html"' in index
    assert index.count('class="text verdict ') == 2
    (folder / "report.html").write_text("mine")
    capsys.readouterr()
    assert main(["report", "runs/short"]) == 2
    assert "bench did not write it" in capsys.readouterr().err
    assert (folder / "report.html").read_text() == "mine"
    assert main(["report", "nowhere"]) == 2
    assert capsys.readouterr().err.count("\n") == 1


def svg_of(text):
    return re.findall(r'<svg class="(?:plot|track)".*?</svg></svg>', text, re.S)


def test_figures_for_a_paper_hold_the_data_and_are_the_same_twice(result, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    figure = result.plot("Position", "free-inertial", width_mm=60.0, serif=True)
    assert figure.get_figwidth() == pytest.approx(60.0 / 25.4)
    for axes, error in zip(figure.axes, result.errors["free-inertial"].pos_n.T, strict=True):
        np.testing.assert_array_equal(axes.lines[0].get_ydata(), error)
    folder = bench.write_result(result, "short", recording=False, report=False)
    written = writing.write_figures(folder, "a", "svg")
    assert {path.name for path in written} >= {"loose-15-position.svg", "comparison.svg", "flight.svg"}
    assert main(["report", "short", "--figures", "svg", "-o", "b"]) == 0
    assert [p.read_bytes() for p in written] == [(tmp_path / "b" / p.name).read_bytes() for p in written]
    with pytest.raises(ConfigError, match="Did you mean 'position'"):
        result.plot("positions")
    with pytest.raises(ConfigError, match="Did you mean 'loose-15'"):
        result.plot("position", "loose-16")


@pytest.mark.parametrize(("tab", "width"), [("flight", 88.0), ("comparison", 60.0)])
def test_a_legend_covers_neither_lines_nor_titles(result, tab, width):
    figure = result.plot(tab, width_mm=width)
    figure.draw_without_rendering()
    page = figure.bbox
    inside = [axes.get_window_extent() for axes in figure.axes]
    titles = [axes._left_title.get_window_extent() for axes in figure.axes]
    legends = [axes.get_legend().get_window_extent() for axes in figure.axes if axes.get_legend()]
    assert legends
    for legend in legends:
        assert page.x0 <= legend.x0 < legend.x1 <= page.x1
        for other in (*inside, *titles):
            across = min(legend.x1, other.x1) - max(legend.x0, other.x0)
            up = min(legend.y1, other.y1) - max(legend.y0, other.y0)
            assert min(across, up) <= 1.0  # [pixel] of 300 an inch


def test_an_index_written_elsewhere_names_the_folders_relative_to_itself(result, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    bench.write_result(result, "runs/short")
    (tmp_path / "pages").mkdir()
    assert main(["report", "runs", "-o", str(tmp_path / "pages" / "index.html")]) == 0
    text = (tmp_path / "pages" / "index.html").read_text(encoding="utf-8")
    assert "../runs/short" in text
    assert f'<td class="text">{result.profile["sensors"]["imu"]}</td>' in text


@pytest.mark.parametrize(("north", "east"), [(100.0, 400.0), (400.0, 100.0), (5.0, 400.0)])
def test_a_track_has_equal_scales_and_no_empty_half(north, east):
    path = np.array([[0.0, 0.0], [north, east]])
    drawn = svg.draw_track(
        [("truth", (1, 2, 3), path)], np.empty((0, 2)), (), [("a", path[0]), ("b", path[1])]
    )
    places = re.findall(r'class="place" cx="([\d.]+)" cy="([\d.]+)"', drawn)
    (x0, y0), (x1, y1) = sorted((float(x), float(y)) for x, y in places)
    assert (x1 - x0) / (y0 - y1) == pytest.approx(east / north, rel=0.05)
    width, height = map(int, re.search(r'viewBox="0 0 (\d+) (\d+)"', drawn).groups())
    assert 0.5 * width < height <= width
    assert min(x0, y1) > 10.0
    bar, length = map(float, re.search(r'class="bar" d="M([\d.]+) \d+h([\d.]+)"', drawn).groups())
    assert bar + length < x0 or bar > x0 + 10.0 or y0 < height - 40.0  # it does not lie on the start
    assert max(x1 - width, y0 - height) < -10.0


def test_ratios_are_drawn_where_they_are_and_open_ends_reach_the_edge():
    rows = [("one", 1.0, 0.5, 2.0), ("open", 10.0, 5.0, None), ("none", None, None, None)]
    drawn = draw_ratios("error", [RatioRow(*row) for row in rows])
    unit = float(re.search(r'class="unit" d="M([\d.]+) ', drawn)[1])
    dots = [float(x) for x in re.findall(r'<circle cx="([\d.]+)"', drawn)]
    bars = [tuple(map(float, one)) for one in re.findall(r'<path d="M([\d.]+) [\d.]+H([\d.]+)"/>', drawn)]
    assert dots[0] == unit
    assert bars[0][0] < dots[0] < bars[0][1]
    assert bars[0][1] - dots[0] == pytest.approx(dots[0] - bars[0][0], abs=0.2)  # a logarithmic axis
    assert len(dots) == 2
    assert bars[1][1] > max(dots)


@pytest.mark.parametrize(
    ("value", "text"),
    [
        (0.0, "0"), (1e-13, "0"), (0.0001, "0.0001"), (2e-5, "2e−5"), (-2e-5, "−2e−5"), (0.25, "0.25"),
        (5000.0, "5000"), (1e4, "10k"), (-5e6, "−5000k"), (1e7, "1e7"), (2.5e10, "2.5e10"),
    ],
)  # fmt: skip
def test_numbers_beside_an_axis_have_room(value, text):
    assert svg.format_mark(value) == text


def test_a_narrow_logarithmic_axis_has_round_numbers_of_a_plain_one():
    """Between 13.9 and 14.1 mm no 1, 2 or 5 of a decade lies: steps of 0.05 mm."""
    at, numbers = svg.round_marks(np.log10(0.0139), np.log10(0.0141), 5, log=True)
    assert numbers == pytest.approx([0.0139, 0.01395, 0.014, 0.01405, 0.0141])
    assert at == pytest.approx(np.log10(numbers))
    assert svg.round_marks(np.log10(0.9), np.log10(6.0), 5, log=True)[1].tolist() == [1.0, 2.0, 5.0]
    assert svg.round_marks(-3.0, 5.0, 5, log=True)[1].tolist() == [1e-3, 1e-1, 1e1, 1e3, 1e5]


def test_one_table_is_the_same_on_a_terminal_and_on_a_page():
    columns = {
        "": ["Position", ShownText("error <h>", tip="pos_h"), ShownText("bench run x", code=True)],
        "first": [ShownFigure(""), ShownFigure("5.1", "1 to 2", outside=True), None],
        "verdict": [ShownText(""), ShownText("worse", "bad"), ShownText("report", link="a b/report.html")],
    }
    table = FindingTable("t", "Title", columns, heads={"": "metric", "first": "mine"})
    kinds = {"verdict": "text"}
    shown = page.render("index.html.jinja", interactive=False, title="Results", table=table, kinds=kinds)
    for line in (
        '<th scope="col">metric</th><th scope="col" title="first">mine</th><th scope="col" class="text">',
        '<tr class="group"><th scope="rowgroup" colspan="3">Position</th></tr>',
        '<tr><th scope="row" title="pos_h">error &lt;h&gt;</th><td class="outside">5.1 '
        '<b title="outside its bounds">!</b> <small>1 to 2</small></td>',
        '<td class="text verdict bad">worse</td></tr>',
        '<tr><th scope="row"><code>bench run x</code></th><td>-</td>'
        '<td class="text"><a href="a%20b/report.html">report</a></td></tr>',
    ):
        assert line in shown
    file = io.StringIO()
    print_table(Console(file=file, width=80), table)
    for words in ("Title", "Position", "error <h>", "5.1 ! (1 to 2)", "worse", "bench run x", "report"):
        assert words in file.getvalue()


def test_nothing_else_writes_tables():
    """Verbs and pages have tables as records; one function prints them and one macro writes them."""
    files = [file for file in PACKAGE.rglob("*") if file.suffix in (".py", ".jinja")]
    texts = {file.name: file.read_text(encoding="utf-8") for file in files}
    assert {name for name, text in texts.items() if "<table" in text} == {"parts.html.jinja", "notebook.py"}
    assert {name for name, text in texts.items() if "rich.table" in text} == {"printing.py"}
