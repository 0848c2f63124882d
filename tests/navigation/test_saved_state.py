"""A saved state is data of somebody: it runs no code, and what does not fit is one clear line."""

from __future__ import annotations

import json
import os
import warnings
from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import bench
from bench.core.words.exceptions import ConfigError, EstimatorError
from bench.io.results import filter_state
from tests.navigation.test_pieces import opened, pieces, record

RUN, SCHEDULE = "/passage/filter/run", "/passage/filter/schedule"


@cache
def saved(use: str) -> tuple[dict[str, Any], Any]:
    """Return the arrays of a filter saved with measurements that wait, and the next piece."""
    filter_, data = opened(use)
    *begun, following, _ = pieces(data, [0.3, 2.1, 4.24, 6.0])
    for piece in begun:
        filter_.update(piece)
    place = bench.write_filter(filter_, Path(os.environ["PYTEST_SAVED"]) / f"{use}.npz")
    with np.load(place) as file:
        return dict(file), following


@pytest.fixture(autouse=True, scope="module")
def _place(tmp_path_factory):
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("PYTEST_SAVED", str(tmp_path_factory.mktemp("saved")))
        yield


def write(path: Path, arrays: dict[str, Any], notes: dict[str, Any] | None = None) -> Path:
    """Write arrays as a saved state with the right sum, so that only what they hold can be wrong."""
    arrays = {name: one for name, one in arrays.items() if name != "sha256"}
    if notes is not None:
        arrays["notes"] = np.array(json.dumps(notes))
    np.savez(path, **arrays, sha256=np.array(filter_state.hash_arrays(arrays)))
    return path


def notes_of(arrays: dict[str, Any]) -> dict[str, Any]:
    return json.loads(str(arrays["notes"]))


def test_a_saved_state_imports_nothing_unless_code_is_allowed(tmp_path, monkeypatch):
    monkeypatch.syspath_prepend(tmp_path)
    (tmp_path / "stranger.py").write_text(
        "from pathlib import Path\n"
        "from bench.navigation.models.loose_tight import Loose as Theirs\n"
        "Path(__file__).with_suffix('.ran').touch()\n"
    )
    arrays, _ = saved("loose-15")
    place = write(tmp_path / "filter.npz", arrays, notes_of(arrays) | {"use": "stranger:Theirs"})
    with pytest.raises(
        EstimatorError, match=r"'stranger:Theirs', which runs code .*; allow_code=True permits"
    ):
        bench.read_filter(place)
    assert not (tmp_path / "stranger.ran").exists()
    assert bench.read_filter(place, allow_code=True).use == "stranger:Theirs"
    assert (tmp_path / "stranger.ran").exists()


def test_a_filter_of_yours_goes_on_if_its_code_is_allowed(tmp_path):
    initial, data = record("loose-15")
    use, given = "bench.navigation.models.loose_tight:Loose", {"gnss_markov": False}
    filter_ = bench.open_filter(use, initial, given, look_back=0.5)
    begun, rest = pieces(data, [4.0])
    filter_.update(begun)
    found = bench.read_filter(bench.write_filter(filter_, tmp_path / "own.npz"), allow_code=True)
    np.testing.assert_array_equal(found.update(rest).cov, filter_.update(rest).cov)


def put(value: Any, at: int = 0) -> Callable[[Any], Any]:
    def change(array: Any) -> Any:
        changed = array.copy()
        changed.flat[at] = value
        return changed

    return change


ALTERED = {
    "a place beyond the samples": (
        "loose-22",
        f"{SCHEDULE}/rows",
        put(10**6, -1),
        "rows must be whole numbers",
    ),
    "a place before them": ("loose-22", f"{SCHEDULE}/earlier", put(-1), "earlier must be whole numbers"),
    "a slot that is not there": (
        "loose-22",
        f"{SCHEDULE}/waiting/slot",
        put(70),
        "slot must be whole numbers",
    ),
    "more rows than a slot has": ("loose-22", f"{RUN}/pending/live", put(10**9, -1), "live must be whole"),
    "a slot of nothing": ("loose-22", f"{RUN}/pending/live", put(6, 0), r"tags \(length\) must be whole"),
    "rows of nothing that waits": (
        "loose-22",
        f"{SCHEDULE}/waiting/slot",
        lambda a: a * 0,
        "of the measurements that wait",
    ),
    "an endless sub-vector": (
        "loose-22",
        f"{RUN}/pending/tags",
        lambda a: a * 0,
        r"\(length\) must be whole",
    ),
    "a sensor that is not there": (
        "loose-22",
        f"{RUN}/pending/tags",
        lambda a: np.add(a, [20, 0, 0, 0]),
        r"\(sensor\) must",
    ),
    "one before the first": (
        "loose-22",
        f"{RUN}/pending/tags",
        lambda a: np.subtract(a, [2, 0, 0, 0]),
        r"\(sensor\) must",
    ),
    "a fourth component": (
        "loose-22",
        f"{RUN}/pending/tags",
        lambda a: np.add(a, [0, 0, 3, 0]),
        r"\(component\)",
    ),
    "a channel beyond": (
        "loose-22",
        f"{RUN}/pending/tags",
        lambda a: np.add(a, [0, 99, 0, 0]),
        r"\(channel\) must",
    ),
    "fewer tags": ("loose-22", f"{RUN}/pending/tags", lambda a: a[:-1], "pending/tags must have"),
    "no slot": ("loose-22", f"{RUN}/pending/live", lambda a: a[:0], "width must hold a fix"),
    "a channel that is not there": (
        "tight",
        f"{RUN}/gate/trust/misses",
        lambda a: a[:-1],
        r"since must have \d+ rows",
    ),
    "fewer sensors": ("loose-22", f"{RUN}/gate/level", lambda a: a[:-1], r"level must have shape \(15,\)"),
    "a smaller covariance": (
        "loose-22",
        f"{RUN}/now/P",
        lambda a: a[:-1],
        r"now/P must have shape \(22, 24\)",
    ),
    "another type": ("loose-22", f"{RUN}/now/dx", lambda a: a.astype(np.int64), "dx must be float64"),
    "no number": ("loose-22", f"{RUN}/now/state", put(np.nan), "state must be finite"),
    "an epoch that is not there": ("tight", f"{SCHEDULE}/sky/epoch_start", put(5), "must rise from 0"),
    "no epoch at all": ("tight", f"{SCHEDULE}/sky/epoch_start", lambda a: a[:0], "must rise from 0"),
    "epochs that begin late": ("tight", f"{SCHEDULE}/sky/epoch_start", put(1), "must rise from 0 to"),
    "epochs that end early": ("tight", f"{SCHEDULE}/sky/epoch_start", put(1, -1), "must rise from 0 to"),
    "epochs that go back": (
        "tight",
        f"{SCHEDULE}/sky/epoch_start",
        lambda a: np.array([0, 9, 4, a[-1]]),
        "must rise from 0 to",
    ),
    "an epoch beyond the last": ("tight", f"{SCHEDULE}/waiting/number", put(1), "number must be whole"),
    "half an ionosphere": ("tight", f"{SCHEDULE}/sky/klobuchar", lambda a: a[:4], r"must have shape \(8,\)"),
    "one height": ("tight", f"{SCHEDULE}/sky/zenith", lambda a: a[:1], "zenith must be a table"),
    "time that stands": ("loose-22", f"{SCHEDULE}/span", lambda a: a * 0, "span must be positive"),
    "one sample less": ("loose-22", f"{SCHEDULE}/imu/t", lambda a: a[:-1], "columns differ in length"),
    "states of another filter": (
        "ukf",
        "/passage/filter/flight/P",
        lambda a: a[:9, :9],
        r"have shape \(16, 16\)",
    ),
}


@pytest.mark.parametrize("case", ALTERED)
def test_an_altered_array_with_the_right_sum_is_refused_in_a_line(tmp_path, case):
    use, name, change, says = ALTERED[case]
    arrays, _ = saved(use)
    place = write(tmp_path / "filter.npz", {**arrays, name: change(arrays[name])})
    with pytest.raises(EstimatorError, match=says) as refused:
        bench.read_filter(place)
    assert str(refused.value).startswith(f"{place}: its state is none of {use!r} with these options: ")
    assert "\n" not in str(refused.value)


def test_arrays_too_many_and_too_few_are_refused(tmp_path):
    arrays, _ = saved("loose-15")
    with pytest.raises(EstimatorError, match="more belongs to nothing"):
        bench.read_filter(write(tmp_path / "filter.npz", {**arrays, "more": np.zeros(3)}))
    fewer = {name: one for name, one in arrays.items() if name != f"{RUN}/now/dx"}
    with pytest.raises(EstimatorError, match=f"{RUN}/now/dx is missing"):
        bench.read_filter(write(tmp_path / "filter.npz", fewer))


def test_a_state_of_another_format_is_refused_in_a_line(tmp_path):
    arrays, _ = saved("loose-15")
    place = write(tmp_path / "filter.npz", arrays, notes_of(arrays) | {"format": 2})
    with pytest.raises(EstimatorError) as refused:
        bench.read_filter(place)
    assert str(refused.value) == (
        f"{place} has format 2 of a saved filter, this bench reads format 3: run the record again"
    )


def test_what_is_packed_or_no_file_is_not_read(tmp_path):
    """Packed zeros of any size fit into a small file; a pipe may have no end."""
    arrays, _ = saved("loose-15")
    np.savez_compressed(tmp_path / "packed.npz", **arrays)
    with pytest.raises(EstimatorError, match=r"holds no filter that bench saved: it is compressed"):
        bench.read_filter(tmp_path / "packed.npz")
    with pytest.raises(ConfigError, match="not a regular file"):
        bench.read_filter("/dev/zero")


def alter(arrays: dict[str, Any], draw: np.random.Generator) -> dict[str, Any]:
    """Return the arrays with one of them cut, doubled, of another type, or with one value changed."""
    name = str(draw.choice([name for name in arrays if name not in ("notes", "sha256")]))
    array = arrays[name]
    odd = {"f": [np.nan, 1e300, -1.0], "i": [-1, 10**9, int(draw.integers(70))], "b": [True, False, True]}
    ways = [
        lambda: array[:-1],
        lambda: np.concatenate([array, array]),
        lambda: np.zeros(array.shape, np.int64 if array.dtype.kind == "f" else np.float64),
        lambda: array.ravel(),
        lambda: np.zeros_like(array),
        lambda: array[::-1].copy(),
        *(lambda k=k: put(odd[array.dtype.kind][k], int(draw.integers(array.size)))(array) for k in range(3)),
    ]
    return {**arrays, name: ways[draw.integers(len(ways))]() if array.size else array.astype(np.int8)}


@pytest.mark.parametrize("use", ["loose-22", "tight", "ukf"])
def test_whatever_is_altered_the_filter_goes_on_or_says_in_a_line_why_not(tmp_path, use):
    """Neither a bare exception nor a place in memory that is none: `EstimatorError`, or answers."""
    arrays, following = saved(use)
    refused = list[str]()
    for seed in range(60):
        place = write(tmp_path / "filter.npz", alter(arrays, np.random.default_rng(seed)))
        try:
            with warnings.catch_warnings():  # what runs on altered numbers may overflow
                warnings.simplefilter("ignore", RuntimeWarning)
                filter_ = bench.read_filter(place)
                filter_.update(following)
                filter_.current()
        except EstimatorError as error:
            refused.append(str(error))
    assert 20 <= len(refused) < 60
    assert "\n" not in "".join(refused)
