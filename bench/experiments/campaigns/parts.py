"""The parts of a journal: up to a thousand finished runs each, found by their keys alone."""

from __future__ import annotations

import re
from collections import OrderedDict
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from bench.core.mathematics.arrays import BoolArray, IntArray
from bench.core.words.exceptions import ConfigError
from bench.io.results.parquet import damages
from bench.io.results.row_parts import Row, join_key, read_index, read_rows, split_key, write_part

ROWS = 1000
"""Most runs of a part."""

_NAME = re.compile(r"journal-(\d{5,9})\.parquet")
_OPEN = 4  # parts whose rows are in memory
_PLACE = np.dtype([("run", "i8"), ("part", "i4"), ("row", "i4"), ("failed", "?")])


def list_parts(folder: Path) -> list[str]:
    """Return the names of the parts in a folder, in the order in which they were written."""
    found = (path.name for path in folder.glob("journal-*.parquet") if _NAME.fullmatch(path.name))
    return sorted(found, key=lambda name: (len(name), name))


class Parts:
    """The parts of a journal: where the row of a key is; if a run is in several, the last one counts.

    Parameters
    ----------
    folder : Path
        Its parts that cannot be read count as ``damaged``: their runs are made again.
    check : callable
        Raises ValueError for a row that no run writes.
    """

    def __init__(self, folder: Path, check: Callable[[Row], None]) -> None:
        self._folder, self._check = folder, check
        self._names: list[str] = []
        self._labels: list[list[frozenset[str]]] = []  # of each part: the filters of each shape
        self._places: dict[str, list[np.ndarray[Any, Any]]] = {}
        self._shapes: list[IntArray] = []
        self._rows: OrderedDict[int, list[Row]] = OrderedDict()
        self.labels: tuple[str, ...] = ()  # of the first run that did not fail completely
        self.damaged = 0
        for name in list_parts(folder):
            try:
                self._add(name)
            except damages():
                self.damaged += 1

    def __len__(self) -> int:
        return len(self._names)

    def _add(self, name: str) -> None:
        """Add the keys of a part to the index."""
        which, cells, runs, shapes, names = read_index(self._folder / name, ROWS)
        failed = np.array([("error",) in shape for shape in names], np.bool_)
        labels = [
            dict.fromkeys(one[1] for one in shape if one[0] == "estimators" and one[1:]) for shape in names
        ]
        places = np.zeros(len(runs), _PLACE)
        places["run"], places["part"] = runs, len(self._names)
        places["row"], places["failed"] = np.arange(len(runs)), failed[shapes]
        places = places[order := np.argsort(runs, kind="stable")]
        which = which[order]
        for k, cell in enumerate(cells):
            self._places.setdefault(cell, []).append(places[which == k])
        if not self.labels:
            self.labels = next((tuple(labels[k]) for k in shapes if labels[k]), ())
        self._names.append(name)
        self._labels.append([frozenset(one) for one in labels])
        self._shapes.append(shapes.astype(np.int32))

    def write(self, rows: Sequence[Row], before: Callable[[str], None]) -> None:
        """Write a part; ``before`` gets its name. Errors as for `write_part`."""
        last = max((int(name[8:-8]) for name in list_parts(self._folder)), default=0)
        name = f"journal-{last + 1:05d}.parquet"
        before(name)
        write_part(self._folder / name, rows)
        self._add(name)

    def _find(self, cell: str) -> Any:
        """Return the places of the runs of a cell, by the number of the run."""
        found = self._places.get(cell)
        if found is None:
            return np.empty(0, _PLACE)
        if len(found) > 1:
            every = np.concatenate(found)
            every = every[np.argsort(every["run"], kind="stable")]
            last = np.append(np.diff(every["run"]) != 0, True)
            self._places[cell] = found = [every[last]]
        return found[0]

    def _locate(self, key: str) -> Any:
        cell, run = split_key(key)
        places = self._find(cell)
        at = int(np.searchsorted(places["run"], run))
        return places[at] if at < len(places) and places["run"][at] == run else None

    def find_finished(self, cell: str, runs: IntArray) -> BoolArray:
        """Return for each number of a run whether it is here and did not fail as a whole."""
        places = self._find(cell)
        return np.isin(runs, places["run"][~places["failed"]])

    def __contains__(self, key: object) -> bool:
        return isinstance(key, str) and self._locate(key) is not None

    def __getitem__(self, key: str) -> Row:
        """Return a row; ConfigError if its part is damaged."""
        place = self._locate(key)
        if place is None:
            raise KeyError(key)
        part = int(place["part"])
        if part not in self._rows:
            while len(self._rows) >= _OPEN:
                self._rows.popitem(last=False)
            path = self._folder / self._names[part]
            try:
                rows = read_rows(path, ROWS)
                for row in rows:
                    self._check(row)
            except damages() as error:
                why = f"{path}: damaged; remove it, and --resume repeats its runs"
                raise ConfigError(why) from error
            self._rows[part] = rows
        self._rows.move_to_end(part)
        return self._rows[part][int(place["row"])]

    def list_last(self) -> set[str]:
        """Return the keys of the last part."""
        last = len(self._names) - 1
        return {
            join_key(cell, int(run))
            for cell in self._places
            for run in self._find(cell)["run"][self._find(cell)["part"] == last]
        }

    def keep_runs_of(self, labels: frozenset[str]) -> int:
        """Forget the runs of other estimators and return their number."""
        other = [np.array([bool(one) and one != labels for one in part]) for part in self._labels]
        if not any(one.any() for one in other):
            return 0
        forgotten = 0
        for cell in self._places:
            places = self._find(cell)
            kept = [not other[part][self._shapes[part][row]] for _, part, row, _ in places]
            forgotten += len(kept) - sum(kept)
            self._places[cell] = [places[np.array(kept, np.bool_)]]
        return forgotten
