"""What the verbs of records print: fixes."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.table import Table

from bench import api


def solve_fixes(
    observations: Path,
    navigation: Sequence[Path],
    *,
    console: Console,
    datum: str,
    out: Path | None,
    **options: Any,
) -> dict[str, Any]:
    """Solve RINEX files, print what came out, write the fixes, and return the figures.

    ``options`` are those of `bench.api.solve_rinex`, ``datum`` is of the positions in ``out``.
    """
    solved = api.solve_rinex(observations, navigation, **options)
    figures = solved.figures()
    table = Table("", "")
    for name, value in figures.items():
        table.add_row(name, f"{value:.3f}" if isinstance(value, float) else str(value))
    console.print(f"{solved.name}: {solved.day}, {len(solved.fixes)} epochs")
    console.print(table)
    if out is not None:
        solved.write_csv(out, datum)
        console.print(f"fixes in {datum}: {out}")
    return figures
