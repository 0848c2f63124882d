"""Print how often tuning finds four wrong noises, and how often its intervals hold the right ones.

``python -m tests.campaigns.tune_power`` takes two hours of CPU: 100 tunings of `loose-15`, whose model is
right but for the sizes of four noises, each on 8 runs of its own of a short flight.
"""

from __future__ import annotations

import argparse
import json
import tempfile
from collections.abc import Iterator, Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import bench
from bench.core.files.places import PACKAGE

WRONG = {"gyro": 5.0, "accel": 0.4, "pos": 0.3, "vel": 4.0}
"""Times the noise on board, in the datasheets that the filter assumes."""

FLIGHT: Mapping[str, Any] = {
    "rate_hz": 100,
    "duration_s": 140.0,
    "gnss_outage": [],
    "leg": [
        {"kind": "straight", "duration_s": 10.0},
        {"kind": "figure-eight", "bank_deg": 30.0, "laps": 2},
    ],
    "evaluation.from_s": 20.0,
    "evaluation.output_hz": 1.0,
}
"""Two figure-eights without an outage, flown by `figure-eight-matched`."""


NEAR = 0.2


@dataclass(frozen=True)
class Repetition:
    """What one tuning found; factors over the right ones."""

    seed: int
    converged: bool
    evaluations: int
    agreed: int
    factors: dict[str, float]
    intervals: dict[str, tuple[float | None, float | None]]
    sentences: tuple[str, ...]

    def holds(self, noise: str) -> bool:
        low, high = self.intervals[noise]
        return (low or 0.0) <= 1.0 and (high is None or high >= 1.0)


def spoil(text: str, wrong: Mapping[str, float]) -> str:
    """Return a datasheet with factors on its white noises, by table or begin of the key."""
    table, lines = "", []
    for line in text.splitlines():
        table = line.strip("[]") if line.startswith("[") else table
        key, _, value = line.partition(" = ")
        noise = key.startswith("noise_") or "white_sd" in key
        factor = wrong.get(table, wrong.get(key.partition("_")[0])) if noise else None
        lines.append(line if factor is None else f"{key} = {factor * float(value)}")
    return "\n".join(lines)


def write_wrong(folder: Path) -> dict[str, str]:
    """Write the wrong datasheets into a folder; return what a filter has to assume."""
    found = {}
    for kind, name in (("imu", "matched-mems"), ("gnss", "matched-white")):
        text = (PACKAGE / "catalog" / kind / f"{name}.toml").read_text()
        path = folder / f"{kind}-wrong.toml"
        path.write_text(spoil(text, WRONG))
        found[f"sensors.assumed.{kind}"] = str(path)
    return found


def repeat(count: int, runs: int = 8, first: int = 31_000) -> Iterator[Repetition]:
    """Yield so many tunings, each with the runs of a seed of its own."""
    with tempfile.TemporaryDirectory() as folder:
        given = {**FLIGHT, **write_wrong(Path(folder))}
        for seed in range(first, first + count):
            found = bench.tune(
                "figure-eight-matched", "loose-15", runs=runs, seed=seed, overrides=given, jobs=1
            )
            by_noise = dict(zip(WRONG.items(), found.factors, strict=True))
            yield Repetition(
                seed,
                found.converged,
                found.evaluations,
                found.agreed,
                {noise: found.factors[name] * wrong for (noise, wrong), name in by_noise.items()},
                {
                    noise: tuple(None if end is None else end * wrong for end in found.intervals[name])
                    for (noise, wrong), name in by_noise.items()
                },
                found.sentences,
            )


def count(rows: list[Repetition]) -> dict[str, tuple[int, int, int, int]]:
    """Return by noise how many intervals hold the right one, factors are within 20 %, and ends are open."""
    return {
        noise: (
            sum(row.holds(noise) for row in rows),
            sum(abs(row.factors[noise] - 1.0) <= NEAR for row in rows),
            sum(row.intervals[noise][0] is None for row in rows),
            sum(row.intervals[noise][1] is None for row in rows),
        )
        for noise in WRONG
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--repetitions", type=int, default=100)
    parser.add_argument("--first", type=int, default=31_000, help="seed of the first")
    given = parser.parse_args()
    rows = []
    for row in repeat(given.repetitions, first=given.first):
        rows.append(row)
        print(json.dumps(asdict(row)), flush=True)
    print(f"converged: {sum(row.converged for row in rows)} of {len(rows)}")
    for noise, (held, near, below, above) in count(rows).items():
        print(
            f"{noise}: interval holds the right factor in {held}, factor within 20 % in {near}, "
            f"no lower end in {below}, no upper end in {above}"
        )


if __name__ == "__main__":
    main()
