"""Names that files of an earlier format have, and the names of today."""

from __future__ import annotations

import re
from collections.abc import Mapping
from typing import Any

from bench.core.words.exceptions import ConfigError

FORMAT = 2
"""Number of the format of results, baselines and cards; 1 if a file has none."""

_RENAMED = (
    ("pos_claimed_h_m", "pos_sigma_h_m"),
    (r"outage_(\d+|\*|\{\})_law(_95)?_h_m", r"outage_\1_predicted\2_h_m"),
    (r"inertial_law_(rms|95)_h_m", r"inertial_predicted_\1_h_m"),
    (r"refused_(\w+)_s", r"longest_rejection_\1_s"),
    (r"answered_(pos|vel|phi)", r"availability_\1"),
    ("claimed_median_h_m", "reported_median_h_m"),
    (r"closed_form_(median|p95)_h_m", r"predicted_\1_h_m"),
)
_PATTERNS = [
    (re.compile('(?<=")unmodelled(?=")|^unmodelled$'), "unmodeled_errors"),  # elsewhere it is a word
    *((re.compile(rf"\b{old}(_all)?\b"), f"{new}\\g<{old.count('(') + 1}>") for old, new in _RENAMED),
]


def rename(text: str) -> str:
    """Return a text with the names of an earlier format replaced by the present names.

    Examples
    --------
    >>> rename("outage_2_law_95_h_m"), rename("refused_baro_s_all"), rename("pos_rmse_h_m")
    ('outage_2_predicted_95_h_m', 'longest_rejection_baro_s_all', 'pos_rmse_h_m')
    """
    for old, new in _PATTERNS:
        text = old.sub(new, text)
    return text


def check_format(document: Mapping[str, Any], shown: str) -> None:
    """Check the number of the format of a document.

    Raises
    ------
    ConfigError
        If it is not `FORMAT`; the message has the command that rewrites an older file.
    """
    found = document.get("format", 1)
    if found == FORMAT:
        return
    if isinstance(found, int) and 1 <= found < FORMAT:
        raise ConfigError(f"{shown}: format {found}, expected format {FORMAT}. Run: bench upgrade {shown}")
    raise ConfigError(f"{shown}: format {found!r}, expected format {FORMAT}: written by a newer bench")
