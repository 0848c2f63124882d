"""What an error does that an estimator does not model, and which built-in estimator has states for it.

An estimator names the errors it does not model (`unmodelled`). The verdict of a run looks up here what
follows from them; no other place knows.
"""

from __future__ import annotations

from collections.abc import Mapping

from bench.navigation.estimator import BUILT_IN, load

EFFECTS: Mapping[str, tuple[str, str]] = {
    "time-correlated GNSS position error": (
        "pos",
        "the GNSS error wanders over minutes and R holds it as white",
    ),
    "time-correlated GNSS velocity error": ("vel", "the GNSS velocity error wanders and R holds it as white"),
    "jumps of the GNSS error where the satellites change": (
        "pos",
        "the GNSS error jumps and R holds it as white",
    ),
    "satellite orbit and clock error": ("pos", "satellite errors last for hours and R holds them as white"),
    "ionosphere beyond the broadcast model": ("pos", "the ionosphere wanders and R holds it as white"),
    "troposphere beyond the model": ("pos", "the troposphere wanders and R holds it as white"),
    "multipath": ("pos", "multipath lasts for minutes and R holds it as white"),
    "GNSS latency": ("pos", "fixes are late and count as if they were of the present"),
    "airspeed bias and scale factor": ("vel", "the airspeed is off by a constant and R holds it as white"),
    "airspeed lag": ("vel", "the airspeed lags behind the motion"),
    "odometer scale factor": ("vel", "the odometer is off by a constant factor and R holds it as white"),
    "magnetometer calibration": (
        "phi",
        "the magnetometer points wrong for the whole run and R holds it as white",
    ),
    "gyro scale factor": ("phi", "every turn leaves an attitude error that Q does not hold"),
    "gyro misalignment": ("phi", "every turn leaves an attitude error that Q does not hold"),
    "gyro g-sensitivity": ("phi", "accelerations turn the attitude, which Q does not hold"),
    "accelerometer scale factor": (
        "vel",
        "accelerations are off by a constant factor, which Q does not hold",
    ),
    "accelerometer misalignment": ("vel", "accelerations leak into other axes, which Q does not hold"),
}
"""Error that is not modelled -> the block whose errors it makes too large ("pos", "vel", "phi"), and how."""


def explain(unmodelled: list[str], block: str) -> str:
    """Explain in a sentence why the errors of a block are larger than claimed; empty if nothing explains it.

    Parameters
    ----------
    unmodelled : list of str
        The errors that the estimator names as not modelled.
    block : str
        "pos", "vel" or "phi".
    """
    for words, (where, effect) in EFFECTS.items():
        if where == block and words in unmodelled:
            return f"{effect} ({words} not modelled); {find_remedy(words)}"
    return ""


def find_remedy(words: str) -> str:
    """Return which built-in estimator has states for an error, in words."""
    for name in BUILT_IN:
        list_blocks = getattr(load(name, {}), "blocks", None)
        if list_blocks and any(words in block.takes for block in list_blocks()):
            return f"{name} has states for it"
    return "no built-in estimator has states for it"
