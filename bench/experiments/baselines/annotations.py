"""Verdicts as annotations of a CI service, shown next to the code change."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path

from bench.core.words.wording import one_line
from bench.experiments.baselines.verdict_rows import OTHER_TRUTH, Verdict

MOVED = "{}: the flight differs from the baseline; record it again with the code of before"
"""Sentence on a profile whose truth, or a log whose sensor data, are not those of its baseline."""

_MOST = 10  # annotations of a kind that GitHub shows of a step


def annotate(
    verdicts: Sequence[Verdict], directory: Path, environment: Mapping[str, str], *, strict: bool = False
) -> Iterator[str]:
    """Yield annotation lines for the log of GitHub Actions or Azure Pipelines; none on other services.

    A metric that is worse is an error, one that is undecided a warning, or an error if ``strict``. A flight
    that is another one is a warning. The file is the baseline. GitLab and Jenkins show the JUnit file.
    """
    if environment.get("GITHUB_ACTIONS") == "true":
        form = _write_github
    elif environment.get("TF_BUILD"):
        form = _write_azure
    else:
        return
    for word in ("worse", "undecided"):
        level = "error" if word == "worse" or strict else "warning"
        rows = [row for row in verdicts if row.word == word]
        for row in rows[:_MOST]:
            file = (directory / f"{row.profile}.json").as_posix()
            yield form(level, file, f"{row.estimator}: {row.metric} is {row.word}", row.sentence)
    moved = dict.fromkeys(row.profile for row in verdicts if row.note.endswith(OTHER_TRUTH))
    for profile in list(moved)[:_MOST]:
        file = (directory / f"{profile}.json").as_posix()
        yield form("warning", file, f"{profile}: another flight", MOVED.format(profile))


def _write_github(level: str, file: str, title: str, text: str) -> str:
    """Return a workflow command; its marks are escaped as the runner of GitHub reads them."""
    file, title = (_escape(one_line(part)).replace(":", "%3A").replace(",", "%2C") for part in (file, title))
    return f"::{level} file={file},title={title}::{_escape(one_line(text))}"


def _write_azure(level: str, file: str, title: str, text: str) -> str:
    file = one_line(file).replace("%", "%AZP25").replace(";", "%3B").replace("]", "%5D")
    return f"##vso[task.logissue type={level};sourcepath={file}]{one_line(text).replace('%', '%AZP25')}"


def _escape(text: str) -> str:
    return text.replace("%", "%25").replace("\r", "%0D").replace("\n", "%0A")
