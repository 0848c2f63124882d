"""Print what was found, the same way for every verb: its tables, then its sentences."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

from rich.console import Console

from bench.findings import FindingTable
from bench.notebook import format_cell
from bench.workbench.divided_table import TableColumn, print_table

_MOST_ROWS = 40  # of a table that are printed


def print_findings(console: Console, sentences: Iterable[str], tables: Iterable[FindingTable] = ()) -> None:
    """Print tables, and a paragraph for each sentence."""
    for table in tables:
        print_finding_table(console, table)
    for sentence in sentences:
        console.print(sentence, soft_wrap=True)


def print_finding_table(console: Console, table: FindingTable) -> None:
    """Print the first rows of a table; if it has to be divided, each part has the columns that name a row."""
    columns = {
        name: TableColumn(
            [format_cell(value) for value in values[:_MOST_ROWS]],
            words=any(isinstance(value, str) for value in values),
        )
        for name, values in table.columns.items()
    }
    print_table(console, columns, _find_keys(table), table.title)
    rows = max((len(values) for values in table.columns.values()), default=0)
    if rows > _MOST_ROWS:
        console.print(f"{rows - _MOST_ROWS} more rows: -o DIR writes all.", style="dim")


def _find_keys(table: FindingTable) -> list[str]:
    """Return the fewest of the first columns that tell all rows apart."""

    def differ(names: Sequence[str]) -> bool:
        rows = list(zip(*(table.columns[name] for name in names), strict=True))
        return len(set(rows)) == len(rows)

    names = list(table.columns)
    keys = next((names[:k] for k in range(1, len(names)) if differ(names[:k])), names[:1])
    for name in keys[1:-1]:
        fewer = [key for key in keys if key != name]
        keys = fewer if differ(fewer) else keys
    return keys
