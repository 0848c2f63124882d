"""Verdicts as a JUnit file, which CI services show as test results."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from xml.etree import ElementTree

from bench.core.files import durable
from bench.core.words.exceptions import ConfigError
from bench.core.words.wording import one_line
from bench.evaluation.requirements.required_metrics import Finding
from bench.evaluation.requirements.share_test import MET
from bench.experiments.baselines.verdict_rows import Verdict


def write_junit(path: Path, verdicts: Sequence[Verdict], *, strict: bool = False) -> None:
    """Write a test case for each metric, a suite for each profile.

    A metric that is worse is a failure, one that is undecided is skipped, or a failure if ``strict``.

    Raises
    ------
    OSError
        If the file cannot be written.
    """
    root = ElementTree.Element("testsuites")
    for profile in dict.fromkeys(row.profile for row in verdicts):
        rows = [row for row in verdicts if row.profile == profile]
        failed, skipped = (sum(_kind(row, strict) == kind for row in rows) for kind in ("failure", "skipped"))
        counts = {"tests": len(rows), "failures": failed, "skipped": skipped, "errors": 0}
        suite = _add(root, "testsuite", name=profile, **counts)
        for row in rows:
            case = _add(suite, "testcase", classname=f"{profile}.{row.estimator}", name=row.metric)
            if kind := _kind(row, strict):
                _add(case, kind, message=row.sentence)
    _write(path, root)


def check_required(path: Path | None, required: object) -> None:
    """Raise ConfigError if a requirements file is requested but there are no requirements.

    Raises
    ------
    ConfigError
        If so.
    """
    if path is not None and not required:
        raise ConfigError("--junit: the file has no [[requirement]]: bench guide profiles")


def write_requirements(path: Path, suite: str, findings: Sequence[Finding]) -> None:
    """Write a test case for each requirement; a requirement that is not met is a failure.

    Raises
    ------
    OSError
        If the file cannot be written.
    """
    failed = sum(one.word != MET for one in findings)
    root = ElementTree.Element("testsuites")
    counts = {"tests": len(findings), "failures": failed, "skipped": 0, "errors": 0}
    cases = _add(root, "testsuite", name=suite, **counts)
    for one in findings:
        name = f"{one.id} {one.metric}".strip()
        case = _add(cases, "testcase", classname=f"{suite}.{one.label}", name=name)
        if one.id or one.text:
            properties = _add(case, "properties")
            for name in ("id", "text"):
                _add(properties, "property", name=f"requirement_{name}", value=getattr(one, name))
        if one.word != MET:
            _add(case, "failure", message=one.sentence)
    _write(path, root)


def _write(path: Path, root: ElementTree.Element) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    ElementTree.indent(root)
    durable.write(path, ElementTree.tostring(root, encoding="unicode", xml_declaration=True) + "\n")


def _add(parent: ElementTree.Element, tag: str, **attributes: object) -> ElementTree.Element:
    """Add an element without control characters, which XML forbids and the name of a profile may contain."""
    named = {name: one_line(str(value)) for name, value in attributes.items()}
    return ElementTree.SubElement(parent, tag, named)


def _kind(row: Verdict, strict: bool) -> str:
    if row.word == "worse" or (strict and row.word == "undecided"):
        return "failure"
    return "skipped" if row.word == "undecided" else ""
