"""What a case holds of a run: bias errors, rows of outages, and what is left after a cut."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
from numpy.testing import assert_allclose

from bench.core.records.data import Events
from bench.core.records.run_records import OffPath
from bench.core.records.specs import EvaluationWindow
from bench.evaluation.consistency.chi_square import SensorNis
from bench.evaluation.errors.error_series import error_series
from bench.evaluation.metrics.case import bias_errors, build_case, collect_alarms, cut_case, find_outage_rows
from tests.evaluation.solutions import weaving_truth, wrong_solution


def test_errors_of_biases_are_against_the_draw_at_the_same_instant():
    """Names of states with their units; what is no bias, or has more components, is left out."""
    names = (
        "gyro_bias_x_rad_s",
        "accel_bias_z_m_s2",
        "baro_bias_m",
        "gnss_bias_m",
        "gyro_bias_w_rad_s",
        "x_scale_1",
    )
    t, drawn_t = np.array([0.0, 1.0, 3.0]), np.array([0.0, 2.0, 4.0])
    drawn = SimpleNamespace(
        t=drawn_t, gyro_bias_b=np.outer(drawn_t, [1.0, 2.0, 3.0]),
        accel_bias_b=np.outer(drawn_t, [4.0, 5.0, 6.0]),
        bias={"baro": drawn_t[:, None] - 7.0, "gnss": np.zeros((3, 2))},
    )  # fmt: skip
    extra = np.arange(18.0).reshape(3, 6)
    solution = SimpleNamespace(t=t, extra_names=names, extra=extra, extra_sd=extra + 1.0)
    found = bias_errors(solution, drawn)
    assert list(found) == ["gyro_bias_x", "accel_bias_z", "baro_bias"]
    for k, truth in enumerate((t, 6.0 * t, t - 7.0)):
        one = list(found.values())[k]
        assert_allclose(one.error, extra[:, k] - truth)
        assert_allclose(one.sd, extra[:, k] + 1.0)
    assert bias_errors(solution, SimpleNamespace(t=np.empty(0))) == {}


def make_case():
    truth = weaving_truth(10.0)
    events = Events.from_rows(
        [(1.0, 1.0, "reset", "a"), (6.0, 7.0, "integrity", "gnss baro"), (6.0, 6.0, "reset", "b")]
    )
    solution = wrong_solution(truth, pos_n=[3.0, 4.0, 1.0], events=events)
    path = OffPath(truth.t, truth.t, 2.0 * truth.t, 3.0 * truth.t)
    return build_case(
        error_series(truth, solution), solution, [(2.0, 3.0), (4.0, 5.0), (6.0, 7.0)],
        missing=np.array([4.5, 5.0]), path=path,
    )  # fmt: skip


def test_outages_without_an_answer_are_left_out_and_keep_their_numbers():
    case = make_case()
    assert case.outages == ((1, 2.0, 3.0), (3, 6.0, 7.0))
    assert find_outage_rows(case) == {"1": (20, 29), "3": (60, 69)}
    late = replace(case, t=case.t[65:])
    assert find_outage_rows(late) == {"3": (0, 4)}
    assert_allclose(case.pos_h, 5.0)
    assert_allclose(case.path.right, case.t)
    assert case.events == {"integrity": 1, "reset": 2}


def test_a_cut_keeps_what_begins_in_it():
    case = make_case()
    window = EvaluationWindow(6.0)
    cut = cut_case(case, window, np.array([4.5, 6.5, 7.5]))
    assert_allclose(cut.t, case.t[60:])
    assert cut.asked == 41 + 2
    assert (cut.outages, cut.events) == (((3, 6.0, 7.0),), {"integrity": 1, "reset": 1})
    assert_allclose(cut.path.above, 2.0 * cut.t)
    assert {
        len(getattr(cut, name)) for name in ("pos_n", "pos_h", "vel_n", "phi_n", "heading", "sd", "nees")
    } == {41}
    assert (len(cut.solution), len(cut.silent), cut.begin) == (41, 41, 6.0)


def test_alarms_are_refusals_and_events_of_integrity():
    t = np.array([1.0, 1.0, 2.0, 3.0])
    nis = {"baro": SensorNis(t, t, np.ones(4, int), np.array([True, False, True, False]))}
    events = Events.from_rows([(5.0, 6.0, "integrity", "why", "gnss baro"), (7.0, 7.0, "reset", "x")])
    refused, told = collect_alarms(nis, events)
    assert (refused.name, refused.sensors, refused.end) == ("baro", ("baro",), None)
    assert (refused.t.tolist(), refused.asked.tolist()) == ([1.0, 3.0], [1.0, 2.0, 3.0])
    assert (told.name, told.sensors, told.t.tolist(), told.end) == ("integrity", ("gnss", "baro"), [5.0], 6.0)
