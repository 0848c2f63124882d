"""Which model of the ionosphere the files of a receiver allow, and what the fixes lose without one."""

from __future__ import annotations

from dataclasses import replace
from datetime import datetime, timedelta

import numpy as np

from bench.core.records.orbit_sets import parse_systems
from bench.plugins.receiver.rinex.ephemerides import NavigationFile
from bench.plugins.receiver.rinex.observations import ObservationFile
from bench.simulation.signals.processing import Ionosphere, Processing

_EPOCH = datetime(1980, 1, 6)
_ENOUGH = 6  # satellites of an epoch, in the median, with which two carriers make fixes; assumed


def choose_ionosphere(
    raw: ObservationFile, nav: NavigationFile, processing: Processing
) -> tuple[Processing, list[str]]:
    """Return the processing with the inputs of the ionosphere model, and messages for the user.

    Without the parameters of the model that is asked for it is the other one, then two carriers, then none.
    """
    when = _EPOCH + timedelta(seconds=raw.origin + float(raw.t[0]))
    level = None if nav.level is None else (float(nav.level[0]), float(nav.level[1]), float(nav.level[2]))
    processing = replace(processing, level=level, day=float(when.timetuple().tm_yday))
    wanted = processing.ionosphere
    if "ionosphere" in processing.without or wanted in ("free", "none"):
        return processing, []
    given = {"klobuchar": nav.klobuchar is not None, "ntcm-g": level is not None}
    if given[wanted]:
        return processing, []
    other: Ionosphere = "ntcm-g" if wanted == "klobuchar" else "klobuchar"
    if given[other]:
        only = "Galileo" if other == "ntcm-g" else "GPS"
        note = f"{nav.shown}: has the ionosphere parameters of {only} only: --ionosphere {other} is used"
        return replace(processing, ionosphere=other), [note]
    lacks = f"{nav.shown}: has no ionosphere parameters"
    served = [system for system, sets in nav.list_orbits().items() if sum(map(len, sets))]
    ours = np.isin(raw.system, [*parse_systems(processing.systems).intersection(served)])
    total = np.concatenate([[0], np.cumsum(ours & np.isfinite(raw.pseudorange).all(axis=1))])
    if np.median(total[raw.epoch_start[1:]] - total[raw.epoch_start[:-1]]) >= _ENOUGH:
        note = f"{lacks}: --ionosphere free, the combination of two carriers, is used"
        return replace(processing, ionosphere="free"), [note]
    sigma = processing.budget.ionosphere_none
    note = (
        f"{lacks}: --ionosphere none is used, and the reported sigma has {sigma:g} m of vertical delay "
        "instead; a navigation file with them makes it smaller"
    )
    return replace(processing, ionosphere="none"), [note]
