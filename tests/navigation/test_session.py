"""The state of every filter is declared: what changes while it runs is carried, or is scratch memory."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, fields, is_dataclass
from datetime import date
from types import SimpleNamespace
from typing import Any, Literal

import numpy as np
import pytest
from numpy.testing import assert_array_equal

from bench.core.mathematics.arrays import FloatArray
from bench.navigation.engine.record_cuts import take_head
from bench.navigation.engine.session import (
    Growing,
    Kept,
    Replaced,
    Scratch,
    SessionState,
    fork,
    marked,
    rebuild,
    require_range,
    require_rows,
)
from tests.navigation.test_pieces import OTHERS, SEVERAL, USES, loaded, pieces, record

EVERY = [*USES, *SEVERAL, *OTHERS]


def values_of(one: object) -> Iterator[tuple[str, Any]]:
    """Yield what an object is made of, by name."""
    if isinstance(one, Mapping):
        yield from ((str(key), value) for key, value in one.items())
    elif hasattr(one, "_fields"):
        yield from zip(one._fields, one, strict=True)
    elif isinstance(one, list | tuple):
        yield from ((str(k), value) for k, value in enumerate(one))
    elif is_dataclass(one):
        yield from ((f.name, getattr(one, f.name)) for f in fields(one))
    elif isinstance(one, SessionState) or type(one).__module__.startswith("bench."):
        yield from getattr(one, "__dict__", {}).items()


def parts(whole: object) -> list[SessionState]:
    """Return every object with a declared state that another is made of, itself included."""
    found, todo, seen = list[SessionState](), [whole], set[int]()
    while todo:
        one = todo.pop()
        if id(one) not in seen:
            seen.add(id(one))
            if isinstance(one, SessionState):
                found.append(one)
            todo += [value for _, value in values_of(one)]
    return found


def freeze(value: Any) -> Any:
    """Return what a value is now, to be compared; a part with a declared state is looked at by itself."""
    if isinstance(value, np.ndarray):
        return value.dtype, value.shape, value.tobytes()
    if isinstance(value, SessionState):
        return id(value)
    inner = list(values_of(value))
    if inner or isinstance(value, list | tuple | dict):
        return type(value), [(name, freeze(one)) for name, one in inner]
    return value if isinstance(value, int | float | str | bool) else id(value)


def snapshot(whole: SessionState) -> dict[int, tuple[SessionState, dict[str, Any]]]:
    """Return of each part what it holds and does not declare."""
    found = {}
    for part in parts(whole):
        declared = {*marked(type(part), "kept"), *marked(type(part), "scratch")}
        rest = {name: freeze(one) for name, one in vars(part).items() if name not in declared}
        found[id(part)] = part, rest
    return found


def undeclared(before: dict[int, tuple[SessionState, dict[str, Any]]], whole: SessionState) -> set[str]:
    """Return the attributes that have changed since and are neither kept nor scratch."""
    changed = set[str]()
    for key, (part, now) in snapshot(whole).items():
        if key in before:
            then = before[key][1]
            names = [name for name in {*now, *then} if now.get(name, now) != then.get(name, then)]
            changed |= {f"{type(part).__name__}.{name}" for name in names}
    return changed


@pytest.mark.parametrize("use", EVERY)
def test_no_filter_changes_what_it_does_not_declare_and_all_it_declares_is_carried(use):
    """Fed in pieces nothing else changes; what it saves half way lets another go on with the same bits."""
    initial, data = record(use)
    head, estimator = take_head(data), loaded(use)
    filter_ = estimator.in_pieces(head, initial, [])
    assert isinstance(filter_, SessionState)
    other, changed = None, set[str]()
    cuts = np.quantile(data.imu.t, [0.2, 0.45, 0.5, 0.8]).tolist()
    for k, piece in enumerate(pieces(data, cuts)):
        before = snapshot(filter_)
        found = filter_.update(piece, 0.5, last=k == len(cuts))
        changed |= undeclared(before, filter_)
        if other is not None:
            again = other.update(piece, 0.5, last=k == len(cuts))
            for name in ("t", "lla", "vel_n", "q_nb", "cov", "extra", "extra_sd"):
                assert_array_equal(getattr(again, name), getattr(found, name), err_msg=name)
            assert again.events.rows() == found.events.rows()
            for name in ("t", "z", "S", "nis", "accepted"):
                assert_array_equal(getattr(again.innovations, name), getattr(found.innovations, name))
        if k == 2:
            other = estimator.in_pieces(head, initial, [])
            other.restore(filter_.copy().state())
    assert not changed


@dataclass(frozen=True)
class Figures:
    values: FloatArray
    name: str


class Inner(SessionState):
    number: Kept[float]

    def __init__(self) -> None:
        self.number, self.calls = 0.0, 0

    def go(self) -> None:
        self.number += 1.0


class Forgetful(Inner):
    def go(self) -> None:
        super().go()
        self.calls += 1


class Outer(SessionState):
    fixed: Kept[FloatArray]
    longer: Kept[Growing[FloatArray]]
    line: Kept[Growing[FloatArray]]
    rows: Kept[FloatArray]
    figures: Kept[Figures | None]
    times: Kept[dict[int, tuple[float, float]]]
    parts: Kept[list[Inner]]
    named: Kept[dict[str, Inner]]
    log: Kept[list[float]]
    shared: Replaced[FloatArray]
    work: Scratch[FloatArray]

    def __init__(self, part: type[Inner] = Inner) -> None:
        self.fixed, self.longer, self.figures = np.zeros(3), np.zeros((1, 2)), None
        self.line, self.rows, self.shared = np.zeros(1), np.zeros((0, 2)), np.full(2, np.inf)
        self.times, self.parts, self.work = {}, [part(), part()], np.zeros(2)
        self.named, self.log = {"a": part()}, [0.0]

    def go(self) -> None:
        self.work += 1.0
        self.fixed += 1.0
        self.longer = np.vstack([self.longer, [[1.0, 2.0]]])
        self.figures, self.times[3] = Figures(np.ones(2), "one"), (1.0, np.inf)
        for part in self.parts:
            part.go()


def test_the_walk_finds_what_changes_undeclared_in_a_part_of_a_part():
    for part, found in ((Inner, set()), (Forgetful, {"Forgetful.calls"})):
        whole = Outer(part)
        before = snapshot(whole)
        whole.go()
        assert undeclared(before, whole) == found


def test_a_copy_goes_on_by_itself():
    one = Outer()
    one.go()
    other = one.copy()
    other.go()
    assert one.fixed.tolist() == [1.0, 1.0, 1.0]
    assert other.fixed.tolist() == [2.0, 2.0, 2.0]
    assert [part.number for part in one.parts] == [1.0, 1.0]
    assert other.parts[0].number == 2.0
    other.times[4] = 0.0, 0.0
    assert list(one.times) == [3]
    assert other.shared is one.shared  # nothing changes it in place
    assert other.line is not one.line


def test_a_restored_state_is_the_one_that_was_saved():
    one, other = Outer(), Outer()
    one.go()
    other.restore(one.state())
    assert freeze(vars(other)["times"]) == freeze(one.times)
    names = {"fixed", "longer", "line", "rows", "figures", "times", "parts", "named", "log", "shared"}
    assert other.state().keys() == names
    assert isinstance(other.figures, Figures)
    assert other.figures.name == "one"
    assert_array_equal(other.longer, one.longer)
    other.fixed += 1.0  # arrays are its own
    assert one.fixed.tolist() == [1.0, 1.0, 1.0]
    before, one.times[5], one.log, one.rows = other.parts[0], (2.0, 3.0), [1.0, 2.0, 3.0], np.ones((4, 2))
    one.longer[0], one.shared = np.nan, np.full(2, np.nan)
    other.restore(one.state())
    assert other.times == {3: (1.0, np.inf), 5: (2.0, 3.0)}
    assert other.log == [1.0, 2.0, 3.0]
    assert_array_equal(other.rows, one.rows)
    assert_array_equal(other.longer, one.longer)
    assert other.parts[0] is before
    one.log = []
    other.restore(one.state())
    assert other.log == []


@pytest.mark.parametrize(
    ("name", "value", "says"),
    [
        ("fixed", np.zeros(4), r"fixed must have shape \(3,\); got \(4,\)"),
        ("fixed", np.zeros(3, np.int64), "fixed must be float64"),
        ("fixed", np.full(3, np.nan), "fixed must be finite"),
        ("fixed", None, "fixed must not be empty"),
        ("fixed", [0.0, 0.0, 0.0], "fixed must be float64"),
        ("line", np.array(3.0), r"line must have shape \('N',\); got \(\)"),
        ("rows", np.zeros((2, 3)), r"rows must have shape \('N', 2\); got \(2, 3\)"),
        ("named", {"b": {"number": 1.0}}, "named must hold a"),
        ("figures", [], "figures must hold values, name"),
        ("longer", np.zeros((5, 3)), r"longer must have shape \('N', 2\); got \(5, 3\)"),
        ("figures", {"values": np.zeros(2)}, "figures must hold values, name"),
        ("figures", {"values": np.zeros(2), "name": 3}, "figures/name must be a str; got 3"),
        ("times", {"3": [1.0]}, "times/3 must have 2 entries; got 1"),
        ("times", {"x": [1.0, 2.0]}, "invalid literal"),
        ("times", [], "times must be a table"),
        ("parts", [{"number": 1.0}], "parts must have 2 entries; got 1"),
        ("parts", [{"number": 1.0}, {"number": True}], "parts/1/number must be a float; got True"),
        ("parts", [{"number": np.inf}, {"number": 1.0}], "parts/0/number must be finite"),
        ("parts", [{"number": 1.0}, {}], "parts/1 must hold number"),
    ],
)
def test_what_does_not_fit_is_named(name, value, says):
    state = Outer().state()
    with pytest.raises(ValueError, match=says):
        Outer().restore({**state, name: value})


def test_names_too_many_and_too_few_are_refused():
    state = Outer().state()
    with pytest.raises(ValueError, match="must hold fixed, longer, line, rows, figures, times, parts, named"):
        Outer().restore({**state, "more": 1.0})
    del state["times"]
    with pytest.raises(ValueError, match="must hold fixed"):
        Outer().restore(state)


def test_the_first_type_that_fits_is_taken():
    assert rebuild(tuple[float, str] | tuple[float, str, str], [1.0, "a", "b"]) == (1.0, "a", "b")
    assert rebuild(float | None, None) is None
    some = tuple[float] | tuple[float, str] | tuple[float, str, str]
    assert [rebuild(some, found) for found in ([1.0], [1.0, "a"], [1.0, "a", "b"])] == [
        (1.0,), (1.0, "a"), (1.0, "a", "b")
    ]  # fmt: skip
    with pytest.raises(ValueError, match="must not be empty"):
        rebuild(some, None)


@pytest.mark.parametrize(
    ("hint", "value", "like", "says"),
    [
        (float, 1, None, None),
        (float, np.inf, None, None),
        (float, np.nan, np.inf, None),
        (float, 2.0, 1.0, None),
        (float, np.inf, 1.0, "must be finite"),
        (float, True, None, "must be a float; got True"),
        (float, "1", None, "must be a float; got '1'"),
        (int, 3, 5, None),
        (int, 1.0, None, "must be a int; got 1.0"),
        (int, True, None, "must be a int; got True"),
        (bool, 1, None, "must be a bool; got 1"),
        (bool, True, False, None),
        (str, "2024-02-03", "a", None),
        (date, 3.0, None, "must be a date; got 3.0"),
        (date, "no", None, "must be a date; got 'no'"),
        (Literal["a", "b"], "b", None, None),
        (Literal["a", "b"], "c", None, "must be one of a, b"),
    ],
)
def test_a_number_a_truth_value_and_a_word_are_what_they_are_declared(hint, value, like, says):
    if says is None:
        found = rebuild(hint, value, like, "x")
        assert found == value or found != found
        assert type(found) is type(value)
    else:
        with pytest.raises(ValueError, match=f"^x {says}$"):
            rebuild(hint, value, like, "x")


def test_a_day_is_saved_as_a_word():
    assert rebuild(date, "2024-02-03") == date(2024, 2, 3)


def test_a_copy_of_an_array_keeps_its_kind_and_wide_rows_begin_at_a_cache_line():
    for array in (
        np.zeros((8, 3)),
        np.zeros((2, 8), np.int64),
        np.zeros((4, 4, 8)),
        np.ones(8),
        np.ones((3, 9)),
    ):
        copy = fork(array)
        assert copy is not array
        assert (copy.dtype, copy.shape) == (array.dtype, array.shape)
    for _ in range(8):
        assert fork(np.zeros((3, 16))).__array_interface__["data"][0] % 64 == 0


def test_columns_have_as_many_rows_and_places_lie_in_what_they_count():
    table = SimpleNamespace(x=np.zeros((3, 2)), y=np.zeros(3))
    require_rows("a", table, ["x", "y"], 3)
    with pytest.raises(ValueError, match=r"^a/x must have shape \(4, 2\); got \(3, 2\)$"):
        require_rows("a", table, ["x"], 4)
    require_range("r", np.array([0, 4]), 5)
    for wrong in (np.array([0, 5]), np.array([-1, 4]), np.array([1.0])):
        with pytest.raises(ValueError, match=r"^r must be whole numbers from 0 to 4$"):
            require_range("r", wrong, 5)
