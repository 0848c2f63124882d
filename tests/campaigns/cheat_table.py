"""Print who cheats, and what the card says: the table of the guide.

``python -m tests.campaigns.cheat_table`` takes eight minutes of CPU: each cheat on the flight of the
quick suite that shows it, with the eight runs of the suite, beside `loose-15`.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, replace
from typing import Any
from unittest.mock import patch

import bench
from bench.core.records.specs import Guard
from bench.experiments.campaigns import running
from bench.experiments.campaigns.pools import ExecutorPool, SerialExecutor
from bench.experiments.card import card_making
from bench.experiments.card.card_suite import LATE, QUICK
from tests.measured import stamp, write_measured

_PLAIN, AHEAD = "s-turns-matched", "looks_ahead"


@dataclass(frozen=True)
class Cheat:
    """What a filter does, and where its card shows it."""

    words: str
    name: str  # in the file, or a built-in filter
    topics: tuple[str, ...] = ("convergence",)
    flight: str = _PLAIN
    options: Mapping[str, Any] = field(default_factory=dict)
    own_process: bool = False
    file: str = "cheats"  # in `tests.campaigns`


CHEATS = (
    Cheat("500 m too high", "TooHigh"),
    Cheat("velocity 20 m/s down", "SinksOnPaper"),
    Cheat("heading 92 deg off", "HeadsWrong"),
    Cheat("stays where it starts, without a covariance", "Frozen"),
    Cheat("answers where its sigma is smallest", "AnswersWhereItIsSure", ("coverage",)),
    Cheat("no attitude where its heading is doubtful", "LosesItsHeading", ("coverage",)),
    Cheat("reports a covariance only where it is sure", "ClaimsWhereItIsSure"),
    Cheat("reports a covariance of zero", "ClaimsToBeExact"),
    Cheat("stamps its answers with times of its own", "StampsItsOwnTimes"),
    Cheat("an alarm every second", "AlwaysAlarms", ("faults", "alarms"), "gnss-faults"),
    Cheat("an alarm every other second", "AlarmsInTurns", ("alarms",), "gnss-faults"),
    Cheat("reports 100 times its sigma", "Gain", ("honesty",), options={"gain": 100.0}),
    Cheat("too narrow and too wide a covariance in turns", "Swings", ("honesty",)),
    Cheat("0.1 s late", "IsLate", ("conventions",)),
    Cheat("velocities east, north, up", "SpeaksEnu", ("conventions",)),
    Cheat("takes fixes before they arrive", "TakesFixesEarly", ("causality",), LATE),
    Cheat("`smoother`, unspoiled", "smoother", ("causality",), LATE),
    Cheat("looks ahead in outages", "AheadInOutages", ("causality",), "figure-eight-matched", file=AHEAD),
    Cheat("looks ahead at the start", "AheadAtTheStart", ("causality",), file=AHEAD),
    Cheat("looks ahead for its biases", "AheadInBiases", ("causality",), file=AHEAD),
    Cheat("a billionth of its velocity looks ahead", "LeaksALittle", ("causality",), file=AHEAD),
    Cheat("reads the memory map of bench", "ReadsItsParent", own_process=True, file=AHEAD),
    Cheat("remembers the records of other runs", "Remembers", ("causality",), LATE, own_process=True),
    Cheat("answers otherwise in another process", "Throws", ("causality",), LATE, own_process=True),
    Cheat(
        "knows the truth, and is a decimeter off",
        "KnowsTheTruth",
        ("accuracy",),
    ),
)


def make_rows() -> Iterator[tuple[str, str]]:
    """Yield who it is, and what the lines of the card say."""
    for one in CHEATS:
        members = tuple(replace(member, without="") for member in QUICK.members if member.name == one.flight)
        use = f"tests.campaigns.{one.file}:{one.name}" if one.name[0].isupper() else one.name
        here = patch.object(running, "choose_pool", lambda *_: ExecutorPool(SerialExecutor(), 1))
        with here, patch.object(card_making, "QUICK", replace(QUICK, members=members)):
            found = bench.make_card(
                use,
                against="loose-15",
                quick=True,
                options=one.options,
                guard=Guard(in_process=not one.own_process),
            )
        lines = {(line.topic, line.figure): line for line in found.lines}
        told = [
            line.sentence.partition(": ")[2].partition("; audit")[0].rstrip(".")
            for (topic, figure), line in lines.items()
            if topic in one.topics and not figure.startswith(("longest time", "largest error"))
        ]
        yield one.words, "; ".join(told)


def main() -> None:
    print("| who | what the card says |\n|---|---|")
    for who, said in make_rows():
        print(f"| {who} | {said} |", flush=True)
    print(f"\n{write_measured([stamp()])}")


if __name__ == "__main__":
    main()
