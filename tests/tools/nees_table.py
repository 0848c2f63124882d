"""Write the NEES table of the guide from the campaigns of ``tests/campaign_files``.

Each is run by ``bench campaign tests/campaign_files/nees.toml -o campaigns/nees`` and alike, with ``--runs``
for fewer runs and ``--resume`` to go on; ``python -m tests.tools.nees_table campaigns`` prints the rows.
Epochs during faults and the minute after them do not count, as in `tests.navigation.honesty`.
"""

from __future__ import annotations

import sys
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from datetime import date
from pathlib import Path

import numpy as np
from scipy.special import stdtrit

from bench.core.files.file_checks import read_json
from bench.core.records.specs import Profile
from bench.evaluation.ensembles.ensemble_consistency import TOLERATED
from bench.experiments.campaigns.groups import Group, gather
from bench.experiments.campaigns.journal import NAME, Journal
from bench.experiments.campaigns.plan import plan_runs
from bench.experiments.campaigns.worker import CHANNELS
from bench.io import results
from tests.measured import SHOWN, write_measured
from tests.navigation.honesty import choose_instants

CAMPAIGN_FILES = Path(__file__).parents[1] / "campaign_files"
TABLES = (
    ("loose-15", "loose-22", "loose-full"),
    ("smoother", "gnss-only", "ukf"),
    ("loose-mems", "baro-inertial"),
    ("free-inertial", "tight"),
    ("invariant-ekf", "graph-smoother"),
    ("fixed-gain", "complementary", "least-squares"),
)
"""Filters of each table, few enough for a terminal."""
LEFT_OUT = {
    "airliner",
    "airliner-long",
    "alpine-approach",
    "cruise-fl350",
    "gate-to-gate",
    "holding-jammed",
    "inspection",
    "mapping",
    "terrain-following",
    "thermal-soaring",
    "touch-and-go",
    "winch-launch",
}
"""Profiles that are there for their truth, and have the sensors and filters of others."""
PARTLY = {"delivery", "hover-and-sprint", "survey-multirotor"}
"""Profiles that only `nees.toml` flies."""
CONFIDENCE = 0.99
"""Of the interval that the mark follows from; the one that is shown has `tests.measured.SHOWN`."""
MARKS = {"consistent": "=", "overconfident": "!", "underconfident": "~", "undecided": "?"}
"""Verdict -> its mark in a cell."""
FEWEST = 5
"""Draws that have an interval in the table."""
MOST_RUNS = 1000
"""Draws that are looked for in a journal."""


@dataclass(frozen=True)
class Row:
    """Mean NEES of a filter on a profile."""

    profile: str
    label: str
    states: int
    draws: int  # evaluated
    lost: int  # did not converge
    mean: float
    half: float  # of the interval that is shown; NaN from one run

    @property
    def word(self) -> str:
        """The word of `ensembles.ensemble_consistency`, by the interval: P is right within 25 %."""
        least, most = (self.states * limit for limit in TOLERATED)
        if not self.draws or np.isnan(self.half):
            return "undecided"
        half = self.half * find_factor(self.draws, CONFIDENCE) / find_factor(self.draws, SHOWN)
        low, high = self.mean - half, self.mean + half
        if low > most:
            return "overconfident"
        if high < least:
            return "underconfident"
        return "consistent" if least <= low and high <= most else "undecided"


def find_factor(draws: int, confidence: float) -> float:
    """Return half of the interval of a mean over its standard error."""
    return float(stdtrit(draws - 1, 0.5 + 0.5 * confidence))


def summarize(profile: str, label: str, states: int, lost: int, averages: np.ndarray) -> Row:
    """Return the row of run averages (R,) of NEES."""
    n = len(averages)
    half = np.nan
    if n > 1:
        half = float(find_factor(n, SHOWN) * averages.std(ddof=1) / np.sqrt(n))
    return Row(profile, label, states, n, lost, float(averages.mean()) if n else np.nan, half)


def measure(file: Path, folder: Path) -> Iterator[Row]:
    """Yield a row for each profile and filter of a campaign file, from the journal in its folder."""
    plan = plan_runs(str(file), MOST_RUNS)
    with Journal(folder / NAME) as journal:
        for group in gather(plan, journal):
            yield judge(group, plan.cells[group.number].profile)


def read_stamp(folder: Path) -> str:
    """Return the day and the commit of a campaign."""
    file = folder / results.CAMPAIGN_RESULT
    commit = str(read_json(file)["commit"] or "no commit")
    return f"{date.fromtimestamp(file.stat().st_mtime)} at {commit[:7]}"


def judge(group: Group, profile: Profile) -> Row:
    """Return the row of a group of runs; epochs at which any of them has no NEES do not count."""
    chosen = choose_instants(profile, group.kept_t) & (group.kept_t >= group.evaluation.first)
    nees = group.kept[group.converged][:, chosen, list(CHANNELS).index("nees")].astype(float)
    nees = nees[:, np.isfinite(nees).all(axis=0)]
    lost = len(group.metrics) - len(nees)
    averages = nees.mean(axis=1) if nees.size else np.empty(0)
    return summarize(group.condition.source, group.label, group.states, lost, averages)


def write_cell(row: Row | None) -> str:
    """Return mean, half of the interval and a mark, as a cell; of few runs their number instead."""
    if row is None or not row.draws:
        return ""
    scale, ending = (1e-6, "e6") if row.mean >= 1e6 else (1.0, "")
    digits = 0 if row.mean >= 100 else 1
    mean, half = (f"{scale * x:.{digits}f}{ending}" for x in (row.mean, row.half))
    lost = f", {row.lost} lost" if row.lost else ""
    if row.draws < FEWEST:
        return f"{mean} of {row.draws}{lost}"
    return f"{mean} ± {half} {MARKS[row.word]}{lost}"


def write_table(rows: Sequence[Row], labels: Sequence[str]) -> Iterator[str]:
    """Yield the lines of a table of some filters, a line for each profile."""
    by = {(row.profile, row.label): row for row in rows}
    yield f"| profile | runs | {' | '.join(f'`{label}`' for label in labels)} |"
    yield "|---" * (2 + len(labels)) + "|"
    for profile in sorted({row.profile for row in rows}):
        found = [by.get((profile, label)) for label in labels]
        draws = sorted({row.draws + row.lost for row in found if row is not None and row.draws >= FEWEST})
        if any(found):
            shown = " to ".join(map(str, dict.fromkeys([draws[0], draws[-1]]))) if draws else ""
            yield f"| `{profile}` | {shown} | {' | '.join(map(write_cell, found))} |"


if __name__ == "__main__":
    campaigns = Path(sys.argv[1])
    found = [
        row
        for file in sorted(CAMPAIGN_FILES.glob("nees*.toml"))
        if (campaigns / file.stem / NAME).exists()
        for row in measure(file, campaigns / file.stem)
    ]
    for labels in TABLES:
        print("\n".join(write_table([row for row in found if row.label in labels], labels)), end="\n\n")
    print(write_measured(read_stamp(folder) for folder in campaigns.iterdir() if (folder / NAME).exists()))
