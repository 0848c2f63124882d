"""One scale for one quantity, the facts of a flight as it was flown, and which filter stands first."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np

from bench.core.records.findings.series import Plot, draw_line
from bench.evaluation.consistency.headline import find_best
from bench.views.plots.content import share_scales
from bench.views.plots.facts import list_facts


def make_rows(label: str, reach: float):
    t = np.linspace(0.0, 10.0, 11)
    line = draw_line("error", t, reach * np.sin(t), "error", (0, 0, 0))
    return [[Plot(("estimators", label, "position", "north"), f"{label}: north position error [m]", (line,))]]


def test_a_quantity_has_one_scale_and_a_filter_that_runs_away_its_own():
    shared = share_scales(
        {"a": make_rows("a", 3.0), "b": make_rows("b", 12.0), "away": make_rows("away", 9000.0)}
    )
    limits = {label: rows[0][0].limits() for label, rows in shared.items()}
    assert limits["a"] == limits["b"] == make_rows("b", 12.0)[0][0].limits()
    assert limits["away"] == make_rows("away", 9000.0)[0][0].limits()


def test_one_estimator_keeps_its_scale():
    assert share_scales({"a": make_rows("a", 3.0)})["a"][0][0].shared is None


def list_facts_of(**profile):
    result = SimpleNamespace(profile=profile, more={}, seed=1, run=0, truth=None, evaluation="")
    return " · ".join(list_facts(result))


def test_wind_layers_and_gusts_are_told():
    layers = [
        {"alt_m": 800.0, "from_deg": 20.0, "speed_mps": 6.0},
        {"alt_m": 600.0, "from_deg": 70.0, "speed_mps": 2.0},
    ]
    wind = {"from_deg": 0.0, "speed_mps": 0.0, "layers": layers, "turbulence": 1}
    text = list_facts_of(wind=wind, gust=[{"start_s": 400.0, "north_mps": -3.0, "east_mps": 4.0}])
    assert "wind 2 m/s from 70° at 600 m to 6 m/s from 20° at 800 m, turbulence 1" in text
    assert "gust of 5 m/s at 400 s" in text
    calm = list_facts_of(wind={"from_deg": 270.0, "speed_mps": 5.0, "layers": [], "turbulence": "none"})
    assert "wind 5 m/s from 270°, turbulence none" in calm
    assert "thermals" not in calm + text
    layer = {"w_star_mps": 3.0, "depth_m": 2600.0}
    rising = list_facts_of(wind={"from_deg": 0.0, "speed_mps": 1.0, "turbulence": 1, "thermals": layer})
    assert "thermals of 3 m/s up to 2600 m above ground" in rising


def test_the_first_filter_whose_claim_holds_and_is_of_use_stands_first():
    lost = {"verdict": "overconfident"}
    right = {"verdict": "consistent"}
    assert find_best({"x": lost, "y": right, "z": right}) == "y"
    assert find_best({"x": lost}) == "x"
    assert find_best({}) == ""
