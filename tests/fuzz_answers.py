"""Wrong answers of a filter: every one is a row of the result, and the filter beside it has its own.

A wrong answer is that of loose-15 after one to three changes, which follow from the bytes of a file.
"""

from __future__ import annotations

import io
import zlib
from collections.abc import Callable
from dataclasses import fields
from pathlib import Path
from typing import Any

import numpy as np

import bench
from bench import pipeline
from bench.cli.verbs.console import PlainConsole
from bench.cli.verbs.flight_verbs import print_result
from bench.core.records.data import Events, Innovations, NavSolution
from bench.core.records.specs import Guard
from bench.core.words.exceptions import BenchError
from bench.io import results
from tests.faults import PROFILE

Random = np.random.Generator

given: Any = None
"""What :class:`Answer` answers next."""

_THINGS: tuple[Any, ...] = (
    None, 0, -1, 1.5, True, "text", b"bytes", (), [], {}, {"a": 1}, object(), NavSolution, np.nan,
    np.empty(0), np.empty((3, 3)), np.array(["x"]), np.array([None, 1]), np.array(1j), lambda: 0,
    np.datetime64("2026-01-01"),
)  # fmt: skip
_TEXTS: tuple[Any, ...] = (
    "", "a", "t_s", "lat_rad", "pos_n", "\x1b[2J</script>", "b\0", "a\nb", "é☃", "x" * 5000, "..", "a/b",
    "{}", "%s", "failed", "not_covered", "traceback", "program", "stderr", "reset", "restart", "alignment",
    "crash", "sanity", "exceedance", "integrity", "gnss", "gnss_position", "gnss_outage", "wind", "ended",
)  # fmt: skip
_NO_TEXTS: tuple[Any, ...] = ("a\ud800", 5, None, b"a")
_NUMBERS = (
    0.0,
    -0.0,
    -1.0,
    1e-320,
    1e-160,
    1e-5,
    1e5,
    1e77,
    1e149,
    1e151,
    1e300,
    1.8e308,
    np.inf,
    -np.inf,
    np.nan,
)
_KINDS: tuple[Any, ...] = (
    np.float32,
    np.float16,
    np.int8,
    np.int64,
    np.uint64,
    np.bool_,
    complex,
    object,
    str,
)


class Answer:
    """A filter that answers what it is given here, whatever that is."""

    def run(self, sensors: Any, initial: Any) -> Any:
        """Answer."""
        return given


class Own(NavSolution):
    """A solution of somebody's own class."""

    __slots__ = ()


def force(record: Any, **changes: Any) -> Any:
    """Return a record with fields that nobody has checked."""
    made = object.__new__(type(record))
    for one in fields(record):
        object.__setattr__(
            made, one.name, changes[one.name] if one.name in changes else getattr(record, one.name)
        )
    return made


def _pick(random: Random, things: Any) -> Any:
    return things[int(random.integers(len(things)))]


def _choose_texts(random: Random, count: int) -> tuple[Any, ...]:
    texts = _TEXTS if random.random() < 0.9 else _TEXTS + _NO_TEXTS
    return tuple(_pick(random, texts) for _ in range(count))


def _choose_field(random: Random, record: Any) -> str:
    return str(_pick(random, [one.name for one in fields(record)]))


def _put_thing(random: Random, found: Any) -> Any:
    return force(found, **{_choose_field(random, found): _pick(random, _THINGS)})


def _change_part(random: Random, found: Any) -> Any:
    """Change a field of the innovations or events."""
    name = str(_pick(random, ("innovations", "events")))
    part = getattr(found, name)
    if not isinstance(part, Innovations | Events):
        return found
    field = _choose_field(random, part)
    value = getattr(part, field)
    if isinstance(value, tuple) and random.random() < 0.8:
        changed: Any = _choose_texts(random, len(value))
    elif isinstance(value, np.ndarray) and random.random() < 0.8:
        changed = _change_column(random, value)
    else:
        changed = _pick(random, _THINGS)
    return force(found, **{name: force(part, **{field: changed})})


def _add_events(random: Random, found: Any) -> Any:
    count = int(random.integers(1, 5))
    times = [random.choice([0.0, 3.0, 1e9, np.nan, -np.inf, -5.0], count) for _ in range(2)]
    words = [_choose_texts(random, count) for _ in range(3)]
    return force(found, events=force(Events(np.empty(0), np.empty(0), (), (), ()), **dict(
        zip(("t", "t_end", "kind", "text", "sensor"), [*times, *words], strict=True))))  # fmt: skip


def _name_states(random: Random, found: Any) -> Any:
    count = int(random.integers(0, 4))
    names = _choose_texts(random, count)
    wide = count + int(random.random() < 0.1)
    extra = [np.full((len(found.lla), wide), _pick(random, _NUMBERS)) for _ in range(2)]
    return force(found, extra_names=names, extra=extra[0], extra_sd=extra[1])


def _change_column(random: Random, column: Any) -> Any:
    """Return a column with other numbers, of another kind or of another shape."""
    column, number = np.array(column), _pick(random, _NUMBERS)
    rows = random.random(len(column)) < _pick(random, (0.01, 0.5, 1.0))
    way = int(random.integers(7))
    with np.errstate(all="ignore"):
        if way == 0:
            return column * number
        if way == 1:
            return column + number
        if way == 2 and column.dtype == float:
            column[rows] = number
        elif way == 3:
            column[rows] = column[random.permutation(len(column))][rows]
        elif way == 4:
            column = column[int(random.integers(3)) :]
        elif way == 5:
            column = np.repeat(column[..., None], int(random.integers(3)), axis=-1)
        else:
            column = column.astype(_pick(random, _KINDS))
    return column


def _change_field(random: Random, found: Any) -> Any:
    arrays = [one.name for one in fields(found) if isinstance(getattr(found, one.name), np.ndarray)]
    name = str(_pick(random, arrays)) if arrays else "t"
    return force(found, **{name: _change_column(random, getattr(found, name))})


def _change_cov(random: Random, found: Any) -> Any:
    cov, number = np.array(found.cov), _pick(random, _NUMBERS)
    i, j = random.integers(9, size=2)
    if random.random() < 0.5 and cov.ndim == 3:
        cov[:, i, j] += number
        return force(found, cov=cov)
    return force(
        found, cov=_pick(random, (-cov, np.ones_like(cov), 0 * cov, np.swapaxes(cov, 0, -1), cov[::-1]))
    )


def _wrap(random: Random, found: Any) -> Any:
    if random.random() < 0.5:
        return force(object.__new__(Own), **{one.name: getattr(found, one.name) for one in fields(found)})
    return _pick(random, (*_THINGS, [found], (found, found), found.lla, object.__new__(NavSolution)))


_WAYS: tuple[Callable[[Random, Any], Any], ...] = (
    _put_thing, _change_part, _change_part, _add_events, _name_states, _change_field, _change_field,
    _change_field, _change_cov,
)  # fmt: skip


def change(random: Random, sound: NavSolution) -> Any:
    """Return a wrong answer."""
    found: Any = sound
    for _ in range(int(random.integers(1, 4))):
        try:
            found = _pick(random, _WAYS)(random, found)
        except Exception:  # it is too wrong already for another change
            break
    return _wrap(random, found) if random.random() < 0.05 else found


def make_answers(folder: Path) -> Any:
    """A run in which the bytes of a file say what a filter answers."""
    global given
    (folder / "short.toml").write_text(PROFILE, encoding="utf-8")
    used = (f"{__name__}:Answer", "loose-15")
    profile = bench.read_profile(folder / "short.toml", estimators=used, guard=Guard(in_process=True))
    truth = bench.fly(profile)
    sensed = bench.sense(profile, truth)
    given = sound = bench.run_filter("loose-15", sensed.data, sensed.initial)
    alone = pipeline.run(profile, truth=truth).metrics["loose-15"]
    path, whole = folder / "answer", b"sound"
    path.write_bytes(whole)

    def look(path: Path) -> Any:
        global given
        text = path.read_bytes()
        given = sound if text == whole else change(np.random.default_rng(zlib.crc32(text)), sound)
        result = pipeline.run(profile, truth=truth, causes=None)
        assert {name: type(one["converged"]) for name, one in result.metrics.items()} == {
            "Answer": bool,
            "loose-15": bool,
        }
        assert result.metrics["loose-15"] == alone
        results.to_json(result.metrics)
        for table in (False, True):
            print_result(PlainConsole(file=io.StringIO(), width=80), result, table=table)
        return result

    def read(path: Path) -> object:
        result = look(path)
        try:
            bench.write_result(result, folder / "run", recording=False, force=True)
            return bench.read_result(folder / "run")
        except BenchError as error:  # no answer is rejected here: it is a row
            raise AssertionError(f"not saved: {error}") from error

    return [path], read, look


def edit(random: Random, path: Path, whole: bytes) -> bytes:
    """Return other bytes."""
    return random.bytes(8)
