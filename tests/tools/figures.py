"""Every metric of every shipped profile: write them down, change the code, compare.

    python -m tests.tools.figures record BEFORE.json                 all profiles, and all filters on one
    python -m tests.tools.figures record BEFORE.json survey static   only these
    python -m tests.tools.figures compare BEFORE.json AFTER.json     exit status 1 when a figure moved

Recordings are compared on one machine with the same libraries. A figure x of a quantity may move by
1e-9 max(|x|, RMSE of the quantity), one of ``ukf`` by 1e-7; counts, verdicts, digests of truth and sensors
and the names of the random streams are equal.
"""

from __future__ import annotations

import hashlib
import json
import math
import sys
import time
from dataclasses import fields, is_dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from bench import pipeline
from bench.core.records.specs import EstimatorChoice
from bench.io.config import list_profiles, read_profile
from bench.navigation.built_in import BUILT_IN

EVERY_ESTIMATOR = "all-sensors"
"""The profile that every built-in filter flies, those that its file does not name included."""
TOLERANCE = {"ukf": 1e-7}
USUAL = 1e-9
COUNTS = ("events_", "updates_", "rejected_", "false_alarms_", "nees_states")
QUANTITIES = {"pos": "pos_rmse_3d_m", "vel": "vel_rmse_3d_mps", "phi": "phi_rmse_d_deg"}
SCALES = {"_m": "pos", "_mps": "vel", "_deg": "phi"}


def digest(record: Any) -> str:
    """Return a hash of the numbers in a record, to the bit; texts do not count."""
    seen = hashlib.sha256()

    def add(value: Any) -> None:
        if is_dataclass(value):
            for name in sorted(field.name for field in fields(value) if field.name != "sensor"):  # a text
                seen.update(name.encode())
                add(getattr(value, name))
        elif isinstance(value, np.ndarray):
            seen.update(np.ascontiguousarray(value).tobytes())
        elif isinstance(value, float):
            seen.update(repr(value).encode())

    add(record)
    return seen.hexdigest()


def record(name: str) -> dict[str, Any]:
    """Return metrics by filter, and digests of what the filters saw."""
    profile = read_profile(name)
    if name == EVERY_ESTIMATOR:
        named = {choice.use for choice in profile.estimators}
        others = (
            EstimatorChoice(use, use) for use, row in BUILT_IN.items() if use not in named and not row.package
        )
        profile = replace(profile, estimators=(*profile.estimators, *others))
    streams: set[str] = set()
    drawn = np.random.SeedSequence

    def watched(entropy: Any = None, *, spawn_key: Any = (), **others: Any) -> np.random.SeedSequence:
        streams.add(str(spawn_key))
        return drawn(entropy, spawn_key=spawn_key, **others)

    np.random.SeedSequence = watched  # type: ignore[assignment, misc]
    truth = pipeline.fly(profile)
    try:
        sensed = pipeline.sense(profile, truth)
    finally:
        np.random.SeedSequence = drawn  # type: ignore[misc]
    data = sensed.data
    seen = {"imu": data.imu, "fixes": data.fixes, "observations": data.observations, **data.instruments}
    return {
        "truth": digest(truth),
        "sensors": {kind: digest(record) for kind, record in seen.items() if record is not None},
        "streams": sorted(streams),
        "metrics": pipeline.run(profile, truth=truth).metrics,
    }


def compare(before: dict[str, Any], after: dict[str, Any]) -> list[str]:
    """Return a line for each figure that moved."""
    lines = []
    for name in sorted(before.keys() | after.keys()):
        if name not in before or name not in after:
            lines.append(f"{name}: only in one recording")
            continue
        inputs = ("truth", "sensors", "streams")
        lines += [f"{name}: {kind} changed" for kind in inputs if before[name][kind] != after[name][kind]]
        old, new = before[name]["metrics"], after[name]["metrics"]
        lines += [f"{name}: filter {use} is only in one recording" for use in sorted(old.keys() ^ new.keys())]
        for use in sorted(old.keys() & new.keys()):
            lines += _moved(old[use], new[use], TOLERANCE.get(use, USUAL), f"{name} {use}")
    return lines


def _moved(old: dict[str, Any], new: dict[str, Any], share: float, place: str) -> list[str]:
    lines = [f"{place}: {key} is gone" for key in sorted(old.keys() - new.keys())]
    for key in sorted(old.keys() & new.keys()):
        a, b = old[key], new[key]
        if isinstance(a, float) and isinstance(b, float) and not key.startswith(COUNTS):
            rmse = next(
                (old.get(QUANTITIES[q]) or 0.0 for end, q in SCALES.items() if key.endswith(end)), 0.0
            )
            if math.isclose(a, b, rel_tol=share, abs_tol=share * rmse):
                continue
        elif a == b:
            continue
        lines.append(f"{place} {key}: {a!r} became {b!r}")
    return lines


def main(arguments: list[str]) -> int:
    """Record or compare."""
    if len(arguments) >= 2 and arguments[0] == "record":
        names = arguments[2:] or [name for name, *_ in list_profiles()]
        found = {}
        for name in names:
            begun = time.process_time()
            found[name] = record(name)
            print(f"{name}: {time.process_time() - begun:.0f} s of CPU", flush=True)
        Path(arguments[1]).write_text(json.dumps(found, indent=1, sort_keys=True) + "\n", encoding="utf-8")
        return 0
    if len(arguments) == 3 and arguments[0] == "compare":
        before, after = (json.loads(Path(name).read_text(encoding="utf-8")) for name in arguments[1:])
        lines = compare(before, after)
        print("\n".join(lines) if lines else f"{len(before)} profiles: no figure moved")
        return 1 if lines else 0
    print(__doc__, file=sys.stderr)
    return 2


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
