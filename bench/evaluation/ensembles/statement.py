"""Uncertainty statement of figures over simulated runs: how each interval follows, and from what."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

METHODS: Mapping[str, str] = {
    "pooled error": "jackknife of the logarithm, Student's t",
    "ratio of errors": "mean of the logarithms of the ratios of the runs, Student's t",
    "NEES over its expectation": "cube root of the mean, Satterthwaite, Student's t, 98 %",
    "count of runs": "Clopper and Pearson",
    "median": "order statistics",
    "fraction of the time": "Student's t over the runs",
}
"""Kind of a figure -> how its interval is computed; 95 % unless said otherwise."""


def state_uncertainty(runs: str, seeds: str, provenance: Mapping[str, Any]) -> dict[str, Any]:
    """Return the statement that goes with intervals over runs.

    Parameters
    ----------
    runs, seeds : str
        Number of independent runs, and where their random numbers come from, in words.
    provenance : mapping
        With the ``commit`` and the ``versions`` that made them.
    """
    return {
        "what_varies": "noise, biases and initial states; the flight where suite or campaign vary it",
        "coverage": "95 %, both sides alike",
        "methods": dict(METHODS),
        "runs": runs,
        "seeds": seeds,
        "commit": provenance.get("commit"),
        "versions": dict(provenance.get("versions", {})),
    }
