"""The real viewer opens what is recorded, and every view has something to show."""

from __future__ import annotations

import io

import matplotlib.pyplot as plt
import pytest

import bench
from tests.recording.screens import find_problem, open_viewer, show_tabs
from tests.test_api import SHORT

PNG = b"\x89PNG"


@pytest.fixture(scope="module")
def viewer_there() -> None:
    problem = find_problem()
    if problem:
        pytest.skip(f"no viewer without a display here: {problem}")


def check_views(result, folder) -> None:
    path, end = bench.write_result(result, folder, report=False) / "flight.rrd", float(result.truth.t[-1])
    with open_viewer(path) as viewer:
        views = viewer.get_state().views
        assert len(views) > 10
        assert {view.name: view.reports for view in views if view.reports} == {}
        logs = [entry.message for entry in viewer.get_logs() if "tile.openstreetmap" not in entry.message]
        assert not [text for text in logs if "ailed to load" in text or "rror while" in text]
        pictures = dict(show_tabs(viewer, 0.5 * end))
    first = ["Overview", "Comparison"] if len(result.solutions) > 1 else ["Overview", "Position"]
    assert list(pictures)[:2] == first
    assert all(picture.startswith(PNG) for picture in pictures.values())
    assert min(map(len, pictures.values())) > 20_000  # an empty window has fewer bytes
    assert find_cursor(pictures["Flight"]) == pytest.approx(
        0.25, abs=0.03
    )  # two plots wide, on the whole flight


def find_cursor(picture: bytes) -> float:
    """Return where the line of the cursor stands in the left half of a picture, as a share of its width."""
    light = plt.imread(io.BytesIO(picture))[:, :, :3].min(axis=2)
    middle = light[len(light) // 10 : -len(light) // 10, : light.shape[1] // 2]
    return float((middle > 0.4).mean(axis=0).argmax() / light.shape[1])


@pytest.mark.long
@pytest.mark.usefixtures("viewer_there")
def test_a_recording_of_five_estimators_opens(tmp_path):
    names = ["loose-15", "loose-22", "gnss-only", "baro-inertial", "free-inertial"]
    profile = bench.read_profile("figure-eight", SHORT, seed=3, estimators=names)
    check_views(bench.run(profile), tmp_path / "five")


@pytest.mark.long
@pytest.mark.usefixtures("viewer_there")
@pytest.mark.parametrize("name", [entry.name for entry in bench.list_profiles()])
def test_the_recording_of_every_shipped_profile_opens(name, tmp_path):
    check_views(bench.run(name), tmp_path / name)
