"""Put the observation files of one receiver together."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from bench.core.words.exceptions import ConfigError
from bench.plugins.receiver.rinex.observations import ObservationFile

_APART = 50.0  # distance of the positions in headers above which they are not one place; assumed [m]


def merge_observations(files: Sequence[ObservationFile]) -> ObservationFile:
    """Return files of one receiver as one, in the order of their times.

    Raises
    ------
    ConfigError
        If their times overlap, or they are of two markers.
    """
    if len(files) == 1:
        return files[0]
    if len(markers := sorted({file.marker for file in files} - {""})) > 1:
        shown = ", ".join(file.shown for file in files)
        raise ConfigError(f"{shown}: are of the markers {', '.join(markers)}; give the files of one receiver")
    files = sorted(files, key=lambda file: file.origin + file.t[0])
    first = files[0]
    t = np.concatenate([file.t + (file.origin - first.origin) for file in files])
    if (np.diff(t) <= 0).any():
        raise ConfigError(f"{', '.join(file.shown for file in files)}: their times overlap")
    names = ("sat", "system", "pseudorange", "doppler", "cn0", "band", "phase", "slipped")
    rows: dict[str, Any] = {name: np.concatenate([getattr(file, name) for file in files]) for name in names}
    counts = np.concatenate([np.diff(file.epoch_start) for file in files])
    others: Mapping[str, int] = {}
    for file in files:
        others = {**file.others, **others}
    spreads = [np.full((len(file.sat), 2), np.nan) if file.sd is None else file.sd for file in files]
    return replace(
        first,
        sd=np.concatenate(spreads),
        shown=", ".join(file.shown for file in files),
        t=t,
        epoch_start=np.concatenate([[0], np.cumsum(counts)]),
        moving=any(file.moving for file in files) or _are_apart(files),
        lost=sum(file.lost for file in files),
        reasons=tuple(reason for file in files for reason in file.reasons),
        recounted=sum(file.recounted for file in files),
        others=others,
        **rows,
    )


def _are_apart(files: Sequence[ObservationFile]) -> bool:
    """Return whether the positions in the headers are not one place."""
    given = [file.approximate_e for file in files if file.approximate_e is not None]
    return any(np.linalg.norm(one - given[0]) > _APART for one in given)
