"""What results show in a notebook, as figures and as frames."""

import numpy as np
import pytest

from bench.core.records.findings import Findings, StudyResult, make_table
from bench.core.records.findings.series import Plot, draw_line
from bench.core.words.exceptions import ConfigError
from bench.core.words.notebook import MOST_ROWS, ShownFigure, write_sentences, write_table


@pytest.fixture
def answer() -> StudyResult:
    rows = [["first <unit>", 1.25], ["second", None]]
    table = make_table("units", "Units", ["imu", "error_m"], rows)
    t = np.linspace(0.0, 10.0, 11)
    line = draw_line("error", t, t**2, "error", (0, 0, 255))
    plot = Plot(("study", "drift"), "drift [m]", (line,), 0.0, 20.0)
    findings = Findings(("The first is better.",), (table,), (plot,))
    return StudyResult("made", "Which?", "bench study made", {}, findings, {}, 1.0)


def test_a_study_shows_its_answer_its_tables_and_its_figures(answer):
    assert repr(answer) == "<StudyResult made: Which?>\nThe first is better."
    shown = answer._repr_html_()
    assert "<p>The first is better.</p>" in shown
    assert "first &lt;unit&gt;</td><td>1.25" in shown
    assert "second</td><td>-" in shown
    frame = answer.frame()
    assert frame["error_m"].tolist()[0] == 1.25
    assert answer.frame("units").equals(frame)
    with pytest.raises(ConfigError, match=r"(?s)'unit' is not in this study.*'units'"):
        answer.frame("unit")
    (line,) = answer.plot().axes[0].lines
    np.testing.assert_array_equal(line.get_ydata(), np.linspace(0.0, 10.0, 11) ** 2)
    with pytest.raises(ConfigError, match=r"(?s)'drfit' has no plots.*'drift'"):
        answer.plot("drfit")
    with pytest.raises(ConfigError, match="only the plots of a run belong to a filter"):
        answer.plot("drift", estimator="loose-15")


def test_a_long_table_is_cut_and_says_so():
    shown = write_table("Many", {"k": range(MOST_ROWS + 7)})
    assert shown.count("<tr>") == MOST_ROWS + 1
    assert "<p>7 more rows</p>" in shown


def test_what_is_outside_is_marked_and_nothing_is_a_tag():
    assert '<td style="color:red">&lt;3 !</td>' in write_table("", {"": [ShownFigure("<3", outside=True)]})
    assert write_sentences(["a < b", ""]) == "<p>a &lt; b</p>"
