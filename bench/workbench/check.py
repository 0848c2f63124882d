"""``bench check``: accuracy limits of profiles, compared or recorded."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from rich.console import Console

from bench import baselines
from bench.config import load_profile
from bench.errors import ConfigError
from bench.workbench import show


def check(directory: Path, names: Sequence[str], *, console: Console, runs: int | None = None) -> bool:
    """Fly the profiles that have a baseline, print the verdicts, and return whether every limit holds.

    Raises
    ------
    ConfigError
        When a baseline or a profile is missing or wrong; before anything flies.
    """
    with Console(stderr=True).status("") as status:
        verdicts = baselines.check(
            directory, names or None, runs, lambda name, k, n: status.update(f"{name}: run {k + 1} of {n}")
        )
    show.verdicts(console, verdicts)
    return not any(row.regressed for row in verdicts)


def record(directory: Path, names: Sequence[str], *, console: Console, runs: int | None = None) -> None:
    """Fly profiles and write what they measure as their baselines.

    Parameters
    ----------
    directory : Path
        Folder of the baselines.
    names : sequence of str
        Profiles, by shipped name or path; those that have a baseline when empty.
    console : Console
        Where the files written are named.
    runs : int or None
        Sensor draws; `bench.baselines.RUNS` when None.

    Raises
    ------
    ConfigError
        When a profile is missing or wrong, or there is none to record.
    """
    sources = list(names) or [baselines.read(path)["profile"] for path in sorted(directory.glob("*.json"))]
    if not sources:
        raise ConfigError(f"{directory}: no baseline to record again; name a profile")
    profiles = [load_profile(source) for source in sources]
    for source, profile in zip(sources, profiles, strict=True):
        with Console(stderr=True).status("") as status:
            baseline = baselines.record(
                profile,
                baselines.RUNS if runs is None else runs,
                source=source,
                progress=lambda name, k, n, say=status: say.update(f"{name}: run {k + 1} of {n}"),  # type: ignore[misc]
            )
        path = baselines.write(directory, baseline)
        console.print(f"Wrote {path}.")
