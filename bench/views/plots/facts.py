"""Facts on the flight and its sensors, in words: for the report and the recording."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any

from bench.core.records.instruments import INSTRUMENTS
from bench.core.records.run_result import RunResult
from bench.io.config.listing import find_unit


def list_facts(result: RunResult) -> Iterable[str]:
    """Yield the facts of a flight or recording, in a few words each."""
    profile = result.profile
    if "log" in result.more:
        kept = profile.get("evaluation", {}).get("withhold")
        if "reference" in profile:
            yield f"a log: errors are estimate minus reference, {profile['reference']['file']}"
        elif "gnss" not in profile:
            yield "a log without receiver and reference"
        else:
            yield "a log without truth: errors are estimate minus fixes that were kept from the filters"
        if kept:
            yield f"one fix in {kept} kept from the filters"
    else:
        yield f"seed {result.seed}, run {result.run}"
    for key in ("aircraft", "script", "trajectory"):
        if key in profile:
            yield f"{key} {profile[key]!s}"
    if result.truth is not None:
        yield f"{result.truth.t[-1] - result.truth.t[0]:.0f} s"
    if wind := profile.get("wind"):
        yield f"{_describe_wind(wind)}, turbulence {wind['turbulence']}"
        if layer := wind.get("thermals"):
            yield f"thermals of {layer['w_star_mps']:g} m/s up to {layer['depth_m']:g} m above ground"
    if gusts := profile.get("gust"):
        yield "; ".join(map(_describe_gust, gusts))
    if "evaluation" in profile:
        yield str(result.evaluation)


def _describe_wind(wind: Mapping[str, Any]) -> str:
    """Return the wind in words; for layers, the lowest and the highest layer."""
    layers = sorted(wind.get("layers") or (), key=lambda one: one["alt_m"])
    if not layers:
        return f"wind {_describe_flow(wind)}"
    ends = layers[:1] if len(layers) == 1 else (layers[0], layers[-1])
    return "wind " + " to ".join(f"{_describe_flow(one)} at {one['alt_m']:g} m" for one in ends)


def _describe_flow(one: Mapping[str, Any]) -> str:
    return f"{one['speed_mps']:g} m/s from {one['from_deg']:g}°"


def _describe_gust(gust: Mapping[str, Any]) -> str:
    peak = sum(float(gust.get(f"{axis}_mps", 0.0)) ** 2 for axis in ("north", "east", "up")) ** 0.5
    return f"gust of {peak:.3g} m/s at {gust['start_s']:g} s"


def list_units(profile: Mapping[str, Any]) -> Iterable[tuple[str, str, str, str]]:
    """Yield kind, name, title and note of each sensor on board or assumed."""
    on_board = profile.get("sensors") or profile.get("assumed") or {}
    titles = {"imu": "IMU", "gnss": "GNSS", **{name: row.title for name, row in INSTRUMENTS.items()}}
    assumed = on_board.get("assumed", {}) if isinstance(on_board, Mapping) else {}
    for kind, title in titles.items():
        other = assumed.get(kind)
        name = on_board.get(kind, other)
        if isinstance(name, str):
            entry = find_unit(kind, name)
            note = entry.note if entry else "own datasheet"
            if isinstance(other, str) and other != name:
                note = f"the filters assume {other}. {note}"
            yield title, name, entry.title if entry else "", note
