"""The verdict of one run in words: do the errors match the reported covariance, and is the drift normal?"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from bench.core.words.wording import format_number
from bench.evaluation.errors.error_series import (
    AXIS_TITLES,
    DIVERGED_HEADING,
    DIVERGED_HEIGHT,
    DIVERGED_HORIZONTAL,
    DIVERGED_TILT,
    DIVERGED_VELOCITY,
    TITLES,
)
from bench.evaluation.linear.drift_laws import RAYLEIGH_95
from bench.evaluation.metrics.coverage import Coverage
from bench.evaluation.requirements.required_metrics import judge_run
from bench.evaluation.requirements.share_test import MET, MISSED

OVERCONFIDENT, UNDERCONFIDENT, CONSISTENT = "overconfident", "underconfident", "consistent"
"""Verdicts by the errors: larger than reported, smaller, neither is shown by this run."""
FAILED, DIVERGED, NO_COVARIANCE, INCOMPLETE = "failed", "diverged", "no covariance", "incomplete"
"""Verdicts without a comparison: no solution, divergence, no covariance, a solution of a part only."""
BROKEN = (OVERCONFIDENT, UNDERCONFIDENT, DIVERGED)
"""Verdicts of a covariance that does not hold."""

UNDECIDED = "undecided"
"""Verdict where fixes scatter less than is reported: an error that wanders slowly in them cannot show."""
NOT_EVALUATED = "not evaluated"
"""Verdict where nothing can judge: no truth, no fix that it has not used, and innovations that fit."""

_LEAST_INSIDE = 0.9  # an axis that is longer outside 3 sigma is named, even if one run allows it [1]
_SMALLEST = float(np.sqrt(-2.0 * np.log(0.95))) / RAYLEIGH_95  # 5 % quantile over the 95 % radius [1]


class _Judgment(NamedTuple):
    """A verdict: its word, its reason in a few words, and a sentence or two."""

    word: str
    reason: str  # "" of a covariance that holds
    text: str


def is_outside(name: str, values: Mapping[str, Any]) -> bool:
    """Return whether a metric lies outside its bounds in one run; False if it has none."""
    value, bounds = values.get(name), find_bounds(name, values)
    if value is None or bounds is None:
        return False
    low, high = bounds
    return bool((low is not None and value < low) or (high is not None and value > high))


def find_bounds(name: str, values: Mapping[str, Any]) -> tuple[float | None, float | None] | None:
    """Return the bounds of a metric in one run; None if it has none."""
    low = high = None
    if name == "nees_mean":
        low, high = values.get("nees_low"), values.get("nees_high")
    elif name.startswith("nees_bias_"):
        low, high = (values.get(name.replace("bias", f"{end}_bias", 1)) for end in ("low", "high"))
    elif name.startswith("nis_mean_"):
        sensor = name.removeprefix("nis_mean_")
        low, high = values.get(f"nis_low_{sensor}"), values.get(f"nis_high_{sensor}")
    elif name.startswith("coverage_3sigma_"):
        low = values.get(name.replace("3sigma", "low", 1))
    elif name.startswith("outage_") and name.endswith("_growth_h_m"):
        high = values.get(name.replace("growth_h", "predicted_95_h", 1))
    elif name == "inertial_end_h_m":
        high = values.get("inertial_predicted_95_h_m")
    return None if low is None and high is None else (low, high)


def add_verdict(
    label: str,
    values: dict[str, Any],
    coverage: Coverage | None = None,
    requirements: Sequence[Mapping[str, Any]] = (),
) -> dict[str, Any]:
    """Return the metrics of a filter with its verdict.

    Parameters
    ----------
    label : str
        Of the estimator.
    values : dict
        Its metrics, with ``why_text`` if it is known why its covariance is broken.
    coverage : Coverage or None
        How much of what was asked for it answers. If that is not enough, it has not converged: a filter that
        is silent where it errs must not look better than one that answers.
    requirements : sequence of mapping
        What it has to keep (`required_metrics.list_requirements`).

    Returns
    -------
    values : dict
        First ``verdict`` (a word), ``verdict_reason`` (what the word stands on; "" of a covariance that
        holds), ``coverage_text`` if it is known, ``verdict_text`` (a sentence or two), ``drift_text`` (a
        sentence for each outage, and for a run without horizontal aiding), ``outside`` (the names of the
        metrics outside their bounds), and where something is required ``required`` (a word) and
        ``required_text`` (a sentence each), then ``values``.
    """
    word, why, text = _judge(label, values)
    covered = {}
    if coverage is not None and not values.get("failed"):
        covered = {"coverage_text": f"{label} {coverage.text}."}
        if coverage.share < 1.0:  # of what is whole nothing need be said
            text = f"{covered['coverage_text']} With its last answer carried on over silences: {text}"
        elif coverage.interval is not None:
            text = f"{covered['coverage_text']} {text}"
        if not coverage.enough:
            good = values["converged"]
            word = INCOMPLETE if good else word
            reason = coverage.text if good else f"{values['reason']}; it {coverage.text}"
            why = reason
            values = {**values, "converged": False, "reason": reason}
        if coverage.first is not None:
            text += f" Its first answer is at t = {coverage.first:g} s."
    outside = [name for name in values if not name.endswith("_all") and is_outside(name, values)]
    judged = {"verdict": word, "verdict_reason": why, **covered, "verdict_text": text}
    drift = judge_drift(label, values)
    found = judge_run(label, values, requirements)
    required = {"required": MISSED if any(one.word == MISSED for one in found) else MET} if found else {}
    sentences = {"required_text": [one.sentence for one in found]} if found else {}
    return {**judged, "drift_text": drift, "outside": outside, **required, **sentences, **values}


def list_sentences(values: Mapping[str, Any]) -> list[str]:
    """Return the sentences of the verdict of a filter after the first: drift and requirements."""
    return [*values.get("drift_text", ()), *values.get("required_text", ())]


def _judge(label: str, values: Mapping[str, Any]) -> _Judgment:
    reason = str(values.get("reason"))
    if values.get("failed"):
        return _Judgment(FAILED, reason.removeprefix(f"{FAILED}: "), f"{label} {reason}")
    error = describe_accuracy(values)
    if not values["converged"]:
        reason = reason.removeprefix(f"{DIVERGED}: ")
        text = f"{label} diverged: {reason}. {error[:1].upper()}{error[1:]}".rstrip(" .")
        return _Judgment(DIVERGED, reason, f"{text}.{_tell_why(values)}")
    if values.get("used_every_fix"):
        return _judge_by_innovations(label, values)
    mean, states = values.get("nees_mean"), values.get("nees_states")
    low, high = values.get("nees_low"), values.get("nees_high")
    if mean is None or states is None or low is None or high is None:
        reason = "reports no covariance to compare with"
        return _Judgment(NO_COVARIANCE, reason, f"{label} {reason}: {error}.")
    between = f"{format_number(low, 3)} to {format_number(high, 3)}"
    figures = f"NEES {format_nees(mean)}, ideal {states:g}, one consistent run {between}"
    narrow = [values.get(f"coverage_3sigma_pos_{axis}") for axis in "ne"]
    inside = [value for value in narrow if value is not None]
    if inside and min(inside) < 0.99:
        axis = ("north", "east")[inside.index(min(inside))] if len(inside) == 2 else "horizontal"
        figures += f"; {axis} position inside 3 sigma {100 * min(inside):.0f} % of the time"
    outside = any(is_outside(f"coverage_3sigma_{axis}", values) for axis in AXIS_TITLES)
    if mean > high or outside:
        reason = describe_nees(values) if mean > high else describe_outside(values)
        if values.get("pos_rmse_h_m", 0.0) > values.get("pos_sigma_h_m", np.inf):
            text = f"{label} is overconfident: {error} ({figures}).{_explain(values)}"
        else:
            text = f"{label} is overconfident: {figures} ({error}).{_explain(values)}"
        return _Judgment(OVERCONFIDENT, reason, text)
    loud, quiet = _find_wrong_innovations(values)
    if "withheld_fixes" in values:  # no truth: its own innovations are the best witness
        if loud:
            reason = _describe_innovations(loud, values)
            text = f"{label} is overconfident by its innovations, {reason}: {error}."
            return _Judgment(OVERCONFIDENT, reason, text)
        if quiet or mean < low:
            small = _describe_innovations(quiet, values) if quiet else describe_nees(values)
            reason = f"{small}: smaller than reported, but slowly varying errors do not appear in it"
            return _Judgment(UNDECIDED, reason, f"{label} is undecided, {reason}; {error}.")
    if mean < low:
        text = f"{label} is underconfident, its covariance is too large: {error} ({figures})."
        return _Judgment(UNDERCONFIDENT, describe_nees(values), text + _tell_why(values))
    word = "consistent with its covariance as far as one run can show"
    if far := find_far_off(values):  # that it is right does not make it of use
        word = f"{word}, but {far}"
    text = f"{label} is {word}: {error} ({figures})."
    if loud or quiet:
        text += f" Its innovations do not fit: {_describe_innovations([*loud, *quiet], values)}."
    return _Judgment(CONSISTENT, "", text)


def _find_wrong_innovations(values: Mapping[str, Any]) -> tuple[list[str], list[str]]:
    """Return the sensors with a mean NIS above its band, and the sensors with a mean NIS below its band."""
    wrong = [
        name.removeprefix("nis_mean_")
        for name in values
        if name.startswith("nis_mean_") and not name.endswith("_all") and is_outside(name, values)
    ]
    loud = [name for name in wrong if values[f"nis_mean_{name}"] > values[f"nis_high_{name}"]]
    return loud, [name for name in wrong if name not in loud]


def _describe_innovations(names: Sequence[str], values: Mapping[str, Any]) -> str:
    """Return the NIS of each sensor with the limit that it exceeds."""
    found = []
    for name in names:
        mean, low, high = (values[f"nis_{part}_{name}"] for part in ("mean", "low", "high"))
        limit = f"at most {format_number(high, 3)}" if mean > high else f"at least {format_number(low, 3)}"
        found.append(f"{name} {mean:.3g} ({limit})")
    return f"NIS of {' and '.join(found)}"


def _judge_by_innovations(label: str, values: Mapping[str, Any]) -> _Judgment:
    """Evaluate an estimate that has used every fix by its innovations, because no truth is available."""
    loud, quiet = _find_wrong_innovations(values)
    used = "it has used every fix, so no fix can evaluate it"
    if values.get("without_fixes"):
        used = "the log has no fixes and no reference to evaluate it"
        if "rests" in values:
            rests = f"{values['rests']} apparent rest{'s' if values['rests'] > 1 else ''}"
            used += f"; at {rests}, tilt is compared with the accelerometers"
    if loud:
        reason = _describe_innovations(loud, values)
        return _Judgment(
            OVERCONFIDENT, reason, f"{label} is overconfident by its innovations, {reason}; {used}."
        )
    if not any(name.startswith("nis_mean_") and not name.endswith("_all") for name in values):
        reason = f"{used}, and the log contains no innovations of it"
    else:
        fit = "its innovations match its covariance"
        if quiet:
            why = ", because their sigma allows for maneuvers" if quiet == ["gravity"] else ""
            fit = f"its innovations are smaller than reported, {_describe_innovations(quiet, values)}{why}"
        reason = f"{used}; {fit}"
    return _Judgment(NOT_EVALUATED, reason, f"{label} is {NOT_EVALUATED}: {reason}.")


def describe_nees(values: Mapping[str, Any]) -> str:
    """Return the mean NEES with its band in words; "" if any of the three values is unknown."""
    mean, low, high = (values.get(f"nees_{name}") for name in ("mean", "low", "high"))
    if mean is None or low is None or high is None:
        return ""
    span = f"{format_number(low, 2)} to {format_number(high, 2)}"
    return f"NEES {format_nees(mean)}; one run of a consistent filter stays within {span}"


def format_nees(value: float) -> str:
    """Return a mean NEES with two digits, or as a whole number from 100 on."""
    return f"{value:.0f}" if value >= 100.0 else f"{value:#.2g}".rstrip(".")


def describe_outside(values: Mapping[str, Any]) -> str:
    """Return the errors that are too often outside 3 sigma, with the fraction of the time, largest first."""
    found = {}
    for axis, words in AXIS_TITLES.items():
        name = f"coverage_3sigma_{axis}"
        inside = values.get(name)
        if inside is not None and (inside < _LEAST_INSIDE or is_outside(name, values)):
            found[words] = 1.0 - inside
    if not found:
        return ""
    worst = sorted(found, key=lambda one: -found[one])
    told = ", ".join(f"{one} {format_share(found[one])}" for one in worst[:3])
    rest = f", {len(worst) - 3} more" if len(worst) > 3 else ""
    return f"errors beyond 3 sigma: {told} of the time{rest}"


def find_far_off(values: Mapping[str, Any]) -> str:
    """Return the size of the error of a consistent solution in words; empty if the error is small.

    The limits are those of `check_convergence`.
    """
    for name, limit, unit, what in (
        ("pos_max_h_m", DIVERGED_HORIZONTAL, "", "off"),
        ("pos_max_v_m", DIVERGED_HEIGHT, "", "off in height"),
        ("vel_max_mps", DIVERGED_VELOCITY, "m/s", "off in velocity"),
        ("tilt_rmse_deg", DIVERGED_TILT, "deg", "off in tilt"),
        ("heading_max_deg", DIVERGED_HEADING, "deg", "off in heading"),
    ):
        value = values.get(name)
        if value is not None and value > limit:
            return f"up to {f'{value:.3g} {unit}' if unit else format_distance(value)} {what}"
    return ""


def _tell_why(values: Mapping[str, Any]) -> str:
    """Return the causes found for an inconsistent covariance, after a space."""
    return f" {values['why_text']}" if values.get("why_text") else ""


def _explain(values: Mapping[str, Any]) -> str:
    """Return the cause of errors larger than reported; if unknown, the block with the largest error."""
    if why := _tell_why(values):
        return why
    ratios = {block: values.get(f"error_over_sigma_{block}") for block in TITLES}
    known = {block: ratio for block, ratio in ratios.items() if ratio is not None}
    worst = max(known, key=lambda block: known[block], default=None)
    if worst is None:
        return ""
    return f" Worst is the {TITLES[worst]}, in 3D: {format_number(known[worst], 3)} sigma, root mean square."


def describe_accuracy(values: Mapping[str, Any]) -> str:
    """Return the actual and the reported horizontal error; for a filter without position, the tilt error."""
    error, claimed = values.get("pos_rmse_h_m"), values.get("pos_sigma_h_m")
    if error is None:
        tilt = values.get("tilt_rmse_deg")
        return "no finite horizontal error" if tilt is None else f"tilt error {tilt:.3g} deg"
    where = "" if claimed is None else f", reported sigma {format_distance(claimed)}"
    if "withheld_fixes" in values:
        return f"distance to withheld fixes {format_distance(error)}{where}"
    return f"horizontal error {format_distance(error)}{where}"


def judge_drift(label: str, values: Mapping[str, Any]) -> list[str]:
    """Return a sentence about each outage or a run without horizontal aiding, if a predicted drift exists."""
    found = []
    for name, most in values.items():
        if name.startswith("outage_") and name.endswith("_predicted_95_h_m"):
            number = name.removeprefix("outage_").removesuffix("_predicted_95_h_m")
            grown, end = values.get(f"outage_{number}_growth_h_m"), values.get(f"outage_{number}_drift_h_m")
            law = values.get(f"outage_{number}_predicted_h_m")
            if grown is not None and end is not None and law is not None and most is not None:
                found.append(
                    f"{label}, outage {number}: the error moved by {format_distance(grown)} and ended at "
                    f"{format_distance(end)}; predicted: {format_distance(law)} rms, "
                    f"{format_distance(most)} at 95 %: {compare_drift(grown, most)}."
                )
    end, law, most = (values.get(f"inertial_{key}_h_m") for key in ("end", "predicted_rms", "predicted_95"))
    if end is not None and law is not None and most is not None:
        found.append(
            f"{label}, unaided: {format_distance(end)} off at the end; its datasheet gives "
            f"{format_distance(law)} rms, {format_distance(most)} at 95 %: {compare_drift(end, most)}."
        )
    return found


def compare_drift(value: float, most: float) -> str:
    """Compare a drift with the 95 % radius of the predicted drift, in words."""
    if value > most:
        return f"more than normal, {value / most:.2g} times the 95 % radius"
    return "normal" if value > _SMALLEST * most else "less than normal"


def format_distance(meters: float) -> str:
    """Format a distance with one decimal, or with two digits below one meter.

    Examples
    --------
    >>> format_distance(5.99), format_distance(0.2964), format_distance(136.9), format_distance(12048.0)
    ('6.0 m', '0.30 m', '137 m', '12.0 km')
    """
    unit, value = ("km", meters / 1000) if abs(meters) >= 999.5 else ("m", meters)
    return f"{round_figure(value)} {unit}"


def round_figure(value: float) -> str:
    """Format a number with one decimal, with two digits below 1, and without decimals from 100 on."""
    if not np.isfinite(value):
        return "without bound"
    size = abs(value)
    return (
        f"{value:.0f}" if size >= 99.5 else f"{value:.1f}" if size >= 0.995 or value == 0 else f"{value:#.2g}"
    )


def format_share(part: float) -> str:
    """Format a fraction in percent, with one decimal below 1 %."""
    return f"{100.0 * part:.0f} %" if part > 0.01 else f"{100.0 * part:.1f} %"
