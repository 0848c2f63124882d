"""The verb tune: progress, what was found, and the tuned datasheets."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from rich.console import Console
from rich.text import Text

from bench.cli.verbs.console import PlainConsole
from bench.cli.verbs.flight_verbs import find_own_estimators
from bench.cli.verbs.printing import print_findings
from bench.core.words.exceptions import ConfigError
from bench.experiments.tuning.noise_factors import Tuning, tune


def run_tuning(source: str, *, console: Console, out: Path, force: bool, **options: Any) -> Tuning:
    """Tune a filter, write its datasheets and print the results; for ``options`` see `bench.tune`."""
    find_own_estimators()
    if not force and any(out.glob("*-tuned.toml")):
        raise ConfigError(f"{out}: has tuned datasheets; --force replaces them, -o names another folder")
    with PlainConsole(stderr=True).status("") as status:
        tuning = tune(source, progress=lambda now: status.update(Text(str(now))), **options)
    paths = tuning.write(out)
    print_findings(console, tuning.sentences)
    for path in paths:
        kind = path.name.removesuffix("-tuned.toml")
        console.print(f"Wrote {path}: --set sensors.assumed.{kind}={path}", soft_wrap=True)
    return tuning
