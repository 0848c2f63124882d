"""Files of an earlier format: rewritten by name alone, or refused in one line and left as they are."""

from __future__ import annotations

import json

import pytest

from bench.cli.command_line import main
from bench.core.words.exceptions import ConfigError
from bench.core.words.renames import FORMAT, check_format, rename
from bench.core.words.wording import suggest
from bench.evaluation.metrics.run_metrics import METRICS, find_metric

OLD = {
    "pos_claimed_h_m": "pos_sigma_h_m",
    "outage_1_law_h_m": "outage_1_predicted_h_m",
    "outage_12_law_95_h_m_all": "outage_12_predicted_95_h_m_all",
    "inertial_law_rms_h_m": "inertial_predicted_rms_h_m",
    "refused_gnss_position_s": "longest_rejection_gnss_position_s",
    "answered_phi_all": "availability_phi_all",
    "unmodelled": "unmodeled_errors",
}
VALUES = [1.0, None, 0.1 + 0.2, -1e-300, 123456789.123]


@pytest.mark.parametrize(("old", "new"), OLD.items())
def test_an_old_name_has_one_of_today_and_is_suggested(old, new):
    assert rename(old) == new
    assert rename(new) == new
    assert new == "unmodeled_errors" or find_metric(new.removesuffix("_all"))
    assert f"Did you mean {new!r}?" in suggest(old, [new, "pos_rmse_h_m"], "metrics")


def test_no_name_of_today_is_taken_for_an_old_one():
    names = [one.name.replace("{}", filled) for one in METRICS for filled in ("1", "pos", "gnss_position")]
    assert [name for name in names if rename(name) != name] == []
    assert rename("every error modelled by the filter") == "every error modelled by the filter"


@pytest.mark.parametrize("mark", ["suite_hash", "truth", "provenance"])
@pytest.mark.parametrize("earlier", [{}, {"format": 1}])
@pytest.mark.parametrize("indent", [None, 2])
def test_a_card_a_baseline_and_a_result_keep_every_digit(
    mark, earlier, indent, tmp_path, monkeypatch, capsys
):
    monkeypatch.chdir(tmp_path)
    note = "an error that is unmodelled"
    document = {**earlier, mark: "x", "metrics": {"a": dict.fromkeys(OLD, VALUES)}, "note": note}
    path = tmp_path / "a.json"
    path.write_text(json.dumps(document, indent=indent))
    assert main(["upgrade", "a.json"]) == 0
    assert "a.json: rewritten" in capsys.readouterr().out
    metrics = {"a": dict.fromkeys(OLD.values(), VALUES)}
    wanted = json.dumps({"format": FORMAT, mark: "x", "metrics": metrics, "note": note}, indent=indent)
    assert "".join(path.read_text().split()) == "".join(wanted.split())
    again = path.read_bytes()
    assert main(["upgrade", "a.json"]) == 0
    assert path.read_bytes() == again
    assert "nothing to change" in capsys.readouterr().out


def test_a_results_folder_and_a_profile_are_rewritten_and_the_rest_of_a_text_stays(
    tmp_path, monkeypatch, capsys
):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "run").mkdir()
    (tmp_path / "run" / "result.json").write_text('{"provenance": {}, "metrics": {"pos_claimed_h_m": 1}}')
    text = '# claimed, not pos_claimed_h_m2\n[[requirement]]\nmetric = "pos_claimed_h_m"\r\nmost = 5.0\n'
    (tmp_path / "p.toml").write_bytes(text.encode())
    assert main(["upgrade", "run", "p.toml"]) == 0
    assert '"pos_sigma_h_m": 1' in (tmp_path / "run" / "result.json").read_text()
    assert 'metric = "pos_sigma_h_m"' in (tmp_path / "p.toml").read_text()
    assert "pos_claimed_h_m2" in (tmp_path / "p.toml").read_text()


@pytest.mark.parametrize(
    ("name", "content"),
    [
        ("a.json", b'{"metrics": {"pos_claimed_h_m": 1}}'),
        ("a.json", b"[1]"),
        ("a.json", b'{"truth": '),
        ("a.json", b"\xff\xfe"),
        ("a.toml", b"\xff\xfe pos_claimed_h_m"),
        ("none.toml", None),
        ("none.json", None),
    ],
)
def test_what_is_no_file_of_bench_is_one_line_and_stays(name, content, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    if content is not None:
        (tmp_path / name).write_bytes(content)
    assert main(["upgrade", name]) == 2
    err = capsys.readouterr().err
    assert err.startswith(f"error: {name}")
    assert err.count("\n") == 1
    assert [path.read_bytes() for path in tmp_path.iterdir()] == ([] if content is None else [content])


@pytest.mark.parametrize(
    ("found", "said"), [({}, "Run: bench upgrade x"), ({"format": 3}, "newer"), ({"format": "2"}, "newer")]
)
def test_another_format_is_named_with_what_to_do(found, said):
    check_format({"format": FORMAT}, "x")
    with pytest.raises(ConfigError, match=said):
        check_format(found, "x")
