"""What a run says of an estimator in a few short lines: for the terminal, pages and the recording."""

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
from bench.evaluation.requirements.required_metrics import MISSED

NEES = (
    "NEES, normalized estimation error squared: squared error over claimed variance, in the mean the number "
    "of states where the claim is right."
)
"""What the figure is by which a claim is judged."""


class Headline(NamedTuple):
    """An estimator in a run; empty texts where there is nothing to say."""

    label: str
    word: str
    look: VerdictLook
    reason: str  # of the word; "" of a claim that holds
    error: str  # and what is claimed
    stops: str  # of the IMU and resets
    fault: str  # that moved it most
    figures: str
    drift: str
    outside: str
    why: str
    required: str
    note: str  # instead of all of these

    @property
    def first(self) -> str:
        """The verdict, its reason and the error, behind the label."""
        return "; ".join(filter(None, (self.word, self.reason, self.error)))

    @property
    def more(self) -> tuple[str, ...]:
        """The lines below the first."""
        if self.note:
            return (self.note,)
        lines = (self.stops, self.fault, self.figures, self.outside, self.drift, self.why, self.required)
        return tuple(filter(None, lines))


def judge_look(word: str, values: Mapping[str, Any] | None = None) -> VerdictLook:
    """Return the look of a verdict; a claim that holds and is of no use is a warning."""
    look = find_look(word)
    useless = look.kind == "good" and values is not None and find_far_off(values)
    return LOOKS[verdict.UNDERCONFIDENT] if useless else look


def find_best(measured: Mapping[str, Mapping[str, Any]]) -> str:
    """Return the label of the first estimator whose claim holds and is of use, or of the first of all."""
    looks = {label: judge_look(str(one.get("verdict", "")), one).kind for label, one in measured.items()}
    good = [label for label, kind in looks.items() if kind == "good"]
    return next(iter([*good, *looks]), "")


def make_headline(label: str, values: Mapping[str, Any], events: Events | None = None) -> Headline:
    """Return the headline of the metrics of an estimator, as `verdict.add_verdict` returns them.

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
        word=f"{word}, but {far}" if far else word,
        look=judge_look(word, values),
        reason=reason,
        error=error,
        stops="" if events is None else _describe_stops(events),
        fault=_describe_fault(values),
        figures="; ".join(filter(None, (*_list_figures(values), "" if reason == nees else nees))),
        drift="; ".join(_list_drifts(values)),
        outside="" if reason == outside else outside,
        why=_describe_why(values),
        required=_describe_required(values),
        note=f"the same as {same} with these sensors" if (same := values.get("same_as")) else "",
    )


def list_stops(events: Events) -> list[str]:
    """Return where a solution stopped, was reset or ended, each with its reason."""
    rows = [row for kind in ("restart", "reset", "ended") for row in events.select(kind)]
    return [f"{begun:g} to {end:g} s: {text}" for begun, end, text in rows]


def _describe_stops(events: Events) -> str:
    first, *rest = list_stops(events) or [""]
    return f"{first}; {len(rest)} more" if rest else first


def _describe_path(values: Mapping[str, Any]) -> str:
    """Return how far a flight that it flew was off its path; "" if it flew none."""
    off = [values.get(f"{part}_across_max_m") for part in ("tse", "fte", "nse")]
    far = [format_distance(value) for value in off if value is not None]
    if len(far) < len(off):
        return ""
    return f"off its path by up to {far[0]}, believed {far[1]}, error of navigation {far[2]}"


def _describe_fault(values: Mapping[str, Any]) -> str:
    """Return whether the fault with the largest error was noticed, and for how long; "" without faults."""
    far = {
        name.split("_")[1]: value
        for name, value in values.items()
        if name.startswith("fault_") and name.endswith("_max_h_m") and value is not None
    }
    number = max(far, key=lambda one: far[one], default="")
    share, delay = (values.get(f"fault_{number}_{name}") for name in ("alarm_share", "delay_s"))
    if share is None:
        return ""
    which = f"fault {number}" if len(far) == 1 else f"fault {number}, the worst of {len(far)}"
    noticed = "not noticed" if delay is None else f"noticed after {format_number(delay, 2)} s"
    refused = f", refused for {format_share(share)} of its time" if share else ""
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
    """Yield the outage with the largest growth beside what is normal, and the end of a run without fixes."""
    grown = {
        name.split("_")[1]: value
        for name, value in values.items()
        if name.startswith("outage_") and name.endswith("_growth_h_m") and value is not None
    }
    end, most = values.get("inertial_end_h_m"), values.get("inertial_law_95_h_m")
    unaided = end is not None and most is not None
    if grown and not unaided:
        number = max(grown, key=lambda one: grown[one])
        law = values.get(f"outage_{number}_law_95_h_m")
        normal = "" if law is None else f", up to {format_distance(law)} is normal"
        which = "GNSS outage" if len(grown) == 1 else f"worst of {len(grown)} GNSS outages"
        yield f"{which}: error grows by {format_distance(grown[number])}{normal}"
    if end is not None and most is not None:
        far, normal = format_distance(end), format_distance(most)
        yield f"without aiding: {far} off at the end, up to {normal} is normal"


def _describe_why(values: Mapping[str, Any]) -> str:
    causes, advice = values.get("causes"), values.get("advice_text")
    if not causes:
        return str(values.get("why_text") or "").replace("Why: ", "why: ", 1)
    names = list(dict.fromkeys(str(one["cause"]) for one in causes))
    return f"why: {'; '.join(names)}.{f' {advice}' if advice else ''}"


def _describe_required(values: Mapping[str, Any]) -> str:
    texts = values.get("required_text") or ()
    if not texts:
        return ""
    label = str(texts[0]).partition(": ")[0]
    missed = [text.removeprefix(f"{label}: ") for text in texts if text.endswith(f"{MISSED}.")]
    return " ".join(missed) or f"required: {len(texts)} met"
