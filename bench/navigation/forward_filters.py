"""The compiled forward filters, with the fixed options of each."""

from __future__ import annotations

from collections.abc import Mapping

FORWARD: Mapping[str, Mapping[str, bool]] = {
    "loose-15": {"gnss_markov": False},
    "loose-22": {"gnss_markov": True},
    "loose-mems": {"gnss_markov": True, "mems": True},
    "loose-full": {"gnss_markov": True, "every_error": True},
    "tight": {"gnss_markov": False},
}
"""The compiled filters that run forward with GNSS -> the options that make each what it is."""
