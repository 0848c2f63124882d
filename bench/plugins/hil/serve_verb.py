"""What the verb serve does: fly with a client, save the result, print a screen of it."""

from __future__ import annotations

import time
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from rich.console import Console

from bench.cli.verbs.flight_verbs import (
    RUNS,
    describe_run,
    find_own_estimators,
    print_end,
    print_result,
    write_first,
)
from bench.core.records.run_result import RunResult
from bench.io import results
from bench.plugins.hil import serving
from bench.plugins.hil.served import load_served


def run_serve(
    name: str,
    *,
    console: Console,
    out: Path | None,
    draw: int,
    recording: bool,
    report: bool,
    force: bool,
    session: Mapping[str, Any],
    overrides: Mapping[str, Any],
    **profile_options: Any,
) -> tuple[RunResult, str]:
    """Fly one profile with a client, as :func:`run` does, and return why the client ended early.

    ``session`` is for `bench.plugins.hil.serving.serve`.
    """
    find_own_estimators()
    profile = load_served(name, overrides, mavlink=session["mavlink"] is not None, **profile_options)
    folder = out or RUNS / f"{profile.name}-{profile.seed}-served"
    results.check_folder(folder, force=force)
    console.print(describe_run(profile.title, profile.seed, draw, profile.evaluation))
    begun = time.perf_counter()
    served = serving.serve(profile, draw, say=console.print, **session)
    with write_first(console, served.result, folder, recording=recording, report=report, force=force):
        console.print(f"Flew {served.flown:g} s with the client.")
        if served.latest > 0:
            console.print(f"It was up to {1e3 * served.latest:.1f} ms behind the rate.")
        if served.ended:
            console.print(f"{served.ended[:1].upper()}{served.ended[1:].rstrip('.')}.", style="red")
        print_result(console, served.result, table=False)
    print_end(console, folder, begun, table=False)
    return served.result, served.ended
