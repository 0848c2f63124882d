"""What is printed below a table of metrics."""

from __future__ import annotations

from io import StringIO

import numpy as np
from rich.console import Console

from bench.cli.verbs import result_table
from bench.core.records.data import Events, NavSolution


def test_a_restart_after_a_gap_is_reported():
    one, none = np.zeros((1, 3)), np.zeros((1, 0))
    events = Events.from_rows([(40.0, 56.0, "restart", "IMU silent for 5 s: started again", "imu")])
    solution = NavSolution(
        np.zeros(1), one, one, np.ones((1, 4)), one, one, np.ones((1, 9, 9)), (), none, none, events=events
    )
    out = StringIO()
    result_table.print_metrics(
        Console(file=out, width=150), {"mine": {"converged": True}}, {"mine": solution}
    )
    assert "mine: 40 to 56 s: IMU silent for 5 s: started again" in out.getvalue()
