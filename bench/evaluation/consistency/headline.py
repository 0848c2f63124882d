"""The result of one filter in a run, in a few short lines: for the terminal, pages and the recording."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any, NamedTuple

from bench.core.records.data import Events
from bench.core.records.findings.looks import LOOKS, VerdictLook, find_look
from bench.core.words.wording import format_number
from bench.evaluation.consistency import verdict
from bench.evaluation.consistency.verdict import (
    describe_accuracy,
    describe_nees,
    describe_outside,
    find_far_off,
    format_distance,
    format_share,
)
from bench.evaluation.requirements.share_test import MISSED

NEES = (
    "NEES is the normalized estimation error squared; if the reported covariance is right, its mean is the "
    "number of states."
)
"""Meaning of the metric behind a verdict."""


_LARGE = ("large error", "large drift")
"""Words for a consistent solution of little use: with aiding, without."""


class Headline(NamedTuple):
    """Result of one filter in a run; a text is empty if it does not apply.

    Attributes
    ----------
    label : str
        Label of the filter.
    word : str
        The verdict in a word or two.
    look : VerdictLook
        Color and sign of the verdict.
    reason : str
        Why the verdict is not "consistent".
    error : str
        Horizontal error and reported sigma.
    stops : str
        IMU gaps and resets.
    fault : str
        The fault with the largest error: whether and when the filter detected it.
    figures : str
        Height, velocity and heading errors, and the NEES.
    drift : str
        Outage drift and its 95 % limit.
    outside : str
        Axes with too many errors beyond 3 sigma.
    why : str
        Causes of an inconsistent covariance.
    required : str
        Requirements that are missed.
    note : str
        Replaces all other lines, if not empty.
    """

    label: str
    word: str
    look: VerdictLook
    reason: str
    error: str
    stops: str
    fault: str
    figures: str
    drift: str
    outside: str
    why: str
    required: str
    note: str

    @property
    def more(self) -> tuple[str, ...]:
        """The lines below the first."""
        if self.note:
            return (self.note,)
        lines = (self.stops, self.fault, self.figures, self.outside, self.drift, self.why, self.required)
        return tuple(filter(None, lines))


def judge_look(word: str, values: Mapping[str, Any] | None = None) -> VerdictLook:
    """Return the color class of a verdict; a consistent solution with a large error is a warning."""
    look = find_look(word)
    useless = look.kind == "good" and values is not None and find_far_off(values)
    return LOOKS[verdict.UNDERCONFIDENT] if useless else look


def find_best(measured: Mapping[str, Mapping[str, Any]]) -> str:
    """Return the label of the first consistent filter without a large error, or of the first filter."""
    looks = {label: judge_look(str(one.get("verdict", "")), one).kind for label, one in measured.items()}
    good = [label for label, kind in looks.items() if kind == "good"]
    return next(iter([*good, *looks]), "")


def make_headline(label: str, values: Mapping[str, Any], events: Events | None = None) -> Headline:
    """Return the headline of the metrics of a filter, as `verdict.add_verdict` returns them.

    With the ``events`` of its solution it says where that stopped and began again.
    """
    word = str(values.get("verdict", ""))
    far = find_far_off(values) if word == verdict.CONSISTENT else ""
    error = describe_accuracy(values) if "pos_rmse_h_m" in values or "tilt_rmse_deg" in values else ""
    error = "; ".join(filter(None, (error, _describe_path(values))))
    nees, outside = describe_nees(values), describe_outside(values)
    reason = str(values.get("verdict_reason") or "")
    return Headline(
        label=label,
        word=_LARGE[values.get("inertial_end_h_m") is not None] if far else word,
        look=judge_look(word, values),
        reason=f"consistent, but {_describe_end(values) or far}" if far else reason,
        error=error,
        stops="" if events is None else _describe_stops(events),
        fault=_describe_fault(values),
        figures="; ".join(filter(None, (*_list_figures(values), "" if reason == nees else nees))),
        drift="" if far and _describe_end(values) else "; ".join(_list_drifts(values)),
        outside="" if reason == outside else outside,
        why=_describe_why(values),
        required=_describe_required(values),
        note=f"the same as {same} with these sensors" if (same := values.get("same_as")) else "",
    )


def list_stops(events: Events) -> list[str]:
    """Return the times at which a solution paused, was reset or ended, each with the reason."""
    rows = [row for kind in ("restart", "reset", "ended") for row in events.select(kind)]
    return [f"{begun:g} to {end:g} s: {text}" for begun, end, text in rows]


def _describe_stops(events: Events) -> str:
    first, *rest = list_stops(events) or [""]
    return f"{first}; {len(rest)} more" if rest else first


def _describe_path(values: Mapping[str, Any]) -> str:
    """Return the path error of the flight that the filter guided; "" if it guided none."""
    off = [values.get(f"{part}_across_max_m") for part in ("tse", "fte", "nse")]
    far = [format_distance(value) for value in off if value is not None]
    if len(far) < len(off):
        return ""
    return f"path error up to {far[0]}: {far[1]} by its own estimate, navigation error {far[2]}"


def find_worst_fault(values: Mapping[str, Any]) -> str:
    """Return the number of the fault with the largest error; "" without faults."""
    far = _list_fault_errors(values)
    return max(far, key=lambda one: far[one], default="")


def _list_fault_errors(values: Mapping[str, Any]) -> dict[str, float]:
    return {
        name.split("_")[1]: value
        for name, value in values.items()
        if name.startswith("fault_") and name.endswith("_max_h_m") and value is not None
    }


def _describe_fault(values: Mapping[str, Any]) -> str:
    """Return whether the fault with the largest error was detected, and for how long; "" without faults."""
    far, number = _list_fault_errors(values), find_worst_fault(values)
    share, delay = (values.get(f"fault_{number}_{name}") for name in ("alarm_share", "delay_s"))
    if share is None:
        return ""
    which = f"fault {number}" if len(far) == 1 else f"fault {number}, the worst of {len(far)}"
    noticed = "not detected" if delay is None else f"detected after {format_number(delay, 2)} s"
    refused = f", rejected for {format_share(share)} of its time" if share else ""
    return f"{which}: {noticed}{refused}, error up to {format_distance(far[number])}"


def _list_figures(values: Mapping[str, Any]) -> Iterator[str]:
    for name, words, unit in (
        ("pos_rmse_d_m", "height", "m"),
        ("vel_rmse_3d_mps", "velocity", "m/s"),
        ("heading_rmse_deg", "heading", "deg"),
    ):
        value = values.get(name)
        if value is not None:
            text = format_distance(value) if unit == "m" else f"{format_number(value, 2)} {unit}"
            yield f"{words} {text}"


def _list_drifts(values: Mapping[str, Any]) -> Iterator[str]:
    """Yield the outage with the largest drift over its prediction, and the final error without fixes."""
    grown = {
        name.split("_")[1]: value
        for name, value in values.items()
        if name.startswith("outage_") and name.endswith("_growth_h_m") and value is not None
    }
    end = _describe_end(values)
    if grown and not end:
        number = max(grown, key=lambda one: grown[one])
        law = values.get(f"outage_{number}_predicted_95_h_m")
        normal = "" if law is None else f", 95 % limit {format_distance(law)}"
        which = "GNSS outage" if len(grown) == 1 else f"worst of {len(grown)} GNSS outages"
        yield f"{which}: drift {format_distance(grown[number])}{normal}"
    if end:
        yield end


def _describe_end(values: Mapping[str, Any]) -> str:
    """Return the final horizontal error of a run without horizontal aiding; "" for any other run."""
    end, most = values.get("inertial_end_h_m"), values.get("inertial_predicted_95_h_m")
    if end is None or most is None:
        return ""
    return f"{format_distance(end)} off at the end without aiding (95 % limit {format_distance(most)})"


def _describe_why(values: Mapping[str, Any]) -> str:
    causes, advice = values.get("causes"), values.get("advice_text")
    if not causes:
        return str(values.get("why_text") or "").replace("Why: ", "cause: ", 1)
    names = list(dict.fromkeys(str(one["cause"]) for one in causes))
    return f"cause: {', '.join(names)}.{f' {advice}' if advice else ''}"


def _describe_required(values: Mapping[str, Any]) -> str:
    texts = values.get("required_text") or ()
    if not texts:
        return ""
    label = str(texts[0]).partition(": ")[0]
    missed = [text.removeprefix(f"{label}: ") for text in texts if text.endswith(f"{MISSED}.")]
    return " ".join(missed) or f"required: {len(texts)} met"
