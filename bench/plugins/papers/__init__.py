"""Algorithms of the two sources that `bench guide equations` names."""

from typing import Any

_NO_FORM = {"form": "joseph", "covariance_precision": "double", "rows": 7}
_GIVEN = "bench.plugins.papers.given_gain_options"

ESTIMATORS: dict[str, dict[str, Any]] = {
    "error-ekf": {
        "title": "the generic filter of the errors of two systems, nonlinear measurement, INS never "
        "corrected, slow",
        "model": "ClassicOptions",
        "fixed": {**_NO_FORM, "feedback": False, "correction_period": 0.0, "admissible_deg": 1.0},
    },
    "fixed-gain": {
        "title": "classic-22 with the gain of a settled filter throughout, slow",
        "model": "ClassicOptions",
        "fixed": _NO_FORM,
    },
    "complementary": {
        "title": "mutual compensation: differences of INS and aid, smoothed and taken off, slow",
        "model": f"{_GIVEN}:ComplementaryOptions",
        "fixed": _NO_FORM,
    },
    "least-squares": {
        "title": "least squares over the past, old measurements with less weight, slow",
        "model": f"{_GIVEN}:LeastSquaresOptions",
        "fixed": _NO_FORM,
    },
}
"""Name of an estimator -> its row in `bench.navigation.built_in`."""
