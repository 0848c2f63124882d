"""The datasheet of an IMU that was measured at rest, and its figures in words."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from bench.core.mathematics.arrays import FloatArray
from bench.core.mathematics.units import from_si, unit_of
from bench.core.records.fields import triad_figures_of
from bench.core.records.sensor_specs import ImuSpec, TriadSpec
from bench.evaluation.motion.noise_curves import AllanResult
from bench.evaluation.motion.noise_fit import SLOW, NoiseEstimate, NoiseFit
from bench.evaluation.motion.pose_fit import PoseFit
from bench.io.parameters.sheet_text import format_sheet

_WORDS = {
    "random_walk": "white noise",
    "bias_instability": "bias instability",
    "rate_random_walk": "rate random walk",
    "quantization": "quantization",
}
_METHOD = (
    "Maximum likelihood, 95 % intervals. The bias instability is flicker noise, a sum of three Gauss-Markov "
    "processes, or one Gauss-Markov process; its value is the minimum of the Allan deviation without white "
    "noise, as in all datasheets of bench, and B of IEEE Std 952 is this value over 0.664. "
)
_NOT_MEASURED = "Not measured: turn-on bias, scale factor, misalignment, range."
_POSES = "Scale factors, misalignments, biases: rms of the axes of one unit. Not measured: range."
_PAIRS = {"accel": "yz, zx, xy", "gyro": "xy, xz, yx, yz, zx, zy"}


def make_measured_spec(name: str, fits: Sequence[NoiseFit], poses: Sequence[PoseFit] = ()) -> ImuSpec:
    """Return the datasheet with the fitted figures of each triad; errors by axis enter with their rms.

    An error is not in the datasheet if the intervals of all its axes contain 0.
    """
    triads = {fit.triad: fit.make_triad() for fit in fits}
    for one in poses:
        figures: dict[str, Any] = {
            field: float(np.sqrt(np.mean(values**2)))
            for field, values, halves in _list_errors(one)
            if one.determined and (np.abs(values) > halves).any()
        }
        triads[one.triad] = replace(triads[one.triad], **figures)
    return ImuSpec(name, triads.get("gyro", TriadSpec()), triads.get("accel", TriadSpec()))


def format_measured_sheet(name: str, measured: AllanResult) -> str:
    """Return the text of the datasheet of an IMU that was measured at rest.

    A parameter with an interval that reaches 0 is not in the sheet; the source has its upper limit.
    """
    fits, poses = measured.fits, measured.poses
    sources = {
        (fit.triad, field): describe_estimate(fit.triad, field, fit.estimates[field])
        for fit in fits
        for field in _WORDS
    }
    notes = [f"{fit.triad}: {line}." for fit in fits for line in list_notes(fit)]
    rest = _POSES if poses else _NOT_MEASURED
    source = " ".join([f"Measured at rest: {measured.record}.", _METHOD + rest, *notes])
    sources |= {
        (one.triad, field): _describe_axes(one.triad, field, values, halves)
        for one in poses
        for field, values, halves in _list_errors(one)
    }
    sources |= {(fit.triad, "bias_correlation"): "fitted, without an interval" for fit in fits}
    spec = make_measured_spec(name, fits, poses)
    return format_sheet(spec, f"{name}, measured at rest", source, sources, digits=4)


def summarize_fit(fit: NoiseFit) -> str:
    """Return one line with the fitted noise of a triad and its 95 % intervals."""
    found = [field for field in _WORDS if fit.estimates[field].identified]
    texts = [
        f"{_WORDS[field]} {describe_estimate(fit.triad, field, fit.estimates[field])}" for field in found
    ]
    return f"{fit.triad}, fitted (95 %): " + "; ".join([*texts, *list_notes(fit)])


def summarize_poses(one: PoseFit) -> str:
    """Return one line with scale factors, misalignments and biases, and their 95 % intervals."""
    known = "poses 20 deg apart" if one.triad == "accel" else "turns"
    words = {"scale_factor_sd": "scale factor", "turn_on_bias_sd": "bias"}
    texts = [
        f"{words.get(field, 'misalignment')} {_describe_axes(one.triad, field, values, halves)}"
        for field, values, halves in _list_errors(one)
        if one.determined
    ]
    missing = [one.missing] if one.missing else []
    return f"{one.triad}, {one.count} {known} (95 %): " + "; ".join([*texts, *missing])


def _list_errors(one: PoseFit) -> Iterator[tuple[str, FloatArray, FloatArray]]:
    """Yield the fields of a datasheet, the errors of the axes, and half of their intervals."""
    yield "turn_on_bias_sd", one.bias, one.bias_half
    yield "scale_factor_sd", one.scale, one.scale_half
    if len(one.angles):
        field = "nonorthogonality_sd" if one.triad == "accel" else "misalignment_sd"
        yield field, one.angles, one.angles_half


def _describe_axes(triad: str, field: str, values: FloatArray, halves: FloatArray) -> str:
    key = triad_figures_of(TriadSpec)[field].keys(field, triad)[0]
    texts = [
        f"{from_si(key, float(value)):.4g} +- {from_si(key, float(half)):.3g}"
        for value, half in zip(values, halves, strict=True)
    ]
    places = _PAIRS[triad] if field in ("nonorthogonality_sd", "misalignment_sd") else "x, y, z"
    return f"{', '.join(texts)} {unit_of(key)} ({places})"


def describe_estimate(triad: str, field: str, one: NoiseEstimate) -> str:
    """Return a fitted figure with its interval in the unit of datasheets.

    Examples
    --------
    >>> print(describe_estimate("gyro", "bias_instability", NoiseEstimate(1e-5, 0.0, 2e-5)))
    below 4.125 deg/h
    """
    key = triad_figures_of(TriadSpec)[field].keys(field, triad)[0]
    value, low, high = (f"{from_si(key, number):.4g}" for number in (one.value, one.low, one.high))
    unit = unit_of(key)
    return f"{value} {unit} ({low} to {high})" if one.identified else f"below {high} {unit}"


def list_notes(fit: NoiseFit) -> Iterator[str]:
    """Yield in words what is not in the figures of a fit: bounds, removed effects, a limited band."""
    for field, words in _WORDS.items():
        if not fit.estimates[field].identified:
            yield f"{words} {describe_estimate(fit.triad, field, fit.estimates[field])}"
    if fit.slow and not any(fit.estimates[field].identified for field in SLOW):
        yield (
            "slow noise is present; the record is too short to separate bias instability and "
            "rate random walk: the most likely values are given"
        )
    for field, axes in fit.axes.items():
        texts = ", ".join(describe_estimate(fit.triad, field, one) for one in axes)
        yield f"{_WORDS[field]} by axis: {texts}"
    key = {"gyro": "deg_h", "accel": "ug"}[fit.triad]
    if fit.transient is not None:
        time, amplitudes = fit.transient
        sizes = ", ".join(f"{from_si(f'x_{key}', float(size)):.3g}" for size in amplitudes)
        yield f"a turn-on transient of {time:.3g} s with {sizes} {unit_of(f'x_{key}')} on x, y, z"
    if fit.temperature is not None:
        slopes = ", ".join(f"{from_si(f'x_{key}_k', float(one)):.3g}" for one in fit.temperature)
        yield f"a bias of {slopes} {unit_of(f'x_{key}_k')} on x, y, z"
    if fit.highest < fit.nyquist:
        yield f"fitted up to {fit.highest:.3g} Hz; above, the noise does not fit the model"
