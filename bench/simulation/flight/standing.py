"""Initial state of an aircraft at rest on its wheels, with brakes set."""

from __future__ import annotations

from typing import Any

import numpy as np

from bench.core.words.exceptions import FlightError
from bench.simulation.flight.cockpit import SURFACES
from bench.simulation.flight.jsbsim_units import FT
from bench.simulation.flight.trimming import (
    INTEGRATORS,
    ON_WHEELS,
    Say,
    TrimCondition,
    keep_quiet,
    place,
    start_engines,
    wait,
)
from bench.simulation.flight.turbulence.wind import set_wind

_ABOVE = (10.0, 100.0)  # heights with the wheels off the ground, of small and large aircraft [ft]
_DROP = 0.02  # from which it is let down on its wheels [m]
_SETTLE = 30.0  # until gear and friction are at rest [s]
_PATIENCE = 100  # such periods: at some headings the wheels creep until friction holds them
_AT_REST = 1e-5  # fastest motion of what is at rest [m/s]


def stand(
    fdm: Any, condition: TrimCondition, *, guided: bool = True, held: bool = False, say: Say = keep_quiet
) -> None:
    """Put the aircraft on the ground at rest, engines idling, with position, heading and wind of a condition.

    Engines of a model that was not made for the bench have a state and are set running. The wings of a glider
    are ``held`` level by its wing runner.

    Raises
    ------
    FlightError
        When it does not come to rest, or is held and has no wing runner.
    """
    set_down(fdm, condition)
    for surface in SURFACES:
        fdm[f"fcs/{surface}-cmd-norm"] = 0.0
        fdm[f"guidance/{surface}-direct-share"] = 1.0
    fdm["guidance/throttle-cmd-norm"] = 0.0
    for side in ("left", "right"):
        fdm[f"fcs/{side}-brake-cmd-norm"] = 1.0
    if held:
        _hold_wings(fdm)
    if not guided:
        start_engines(fdm)  # and come to their idle while it settles
    come_to_rest(fdm, say)


def _hold_wings(fdm: Any) -> None:
    runner = fdm.get_property_manager().get_node("winch/runner-norm")
    if runner is None:
        need = 'its model needs <system file="winch"/> and the forces of a hook, as sgs.xml has them'
        raise FlightError(f"aircraft {fdm.get_model_name()}: nothing holds its wings on the ground; {need}")
    runner.set_double_value(1.0)


def set_down(fdm: Any, condition: TrimCondition) -> None:
    """Put what has wheels or legs just above the ground, at rest, with the wind of a condition."""
    place(fdm, condition, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
    for name in ("u-fps", "v-fps", "w-fps", "phi-rad", "theta-rad"):
        fdm[f"ic/{name}"] = 0.0
    manager = fdm.get_property_manager()  # what is no wheel counts among the units too
    units = (manager.get_node(f"gear/unit[{k}]/AGL-ft") for k in range(int(fdm["gear/num-units"])))
    wheels = [unit for unit in units if unit is not None]
    if not wheels:
        raise FlightError(f"aircraft {fdm.get_model_name()} has no wheels to stand on")
    for above in _ABOVE:
        fdm["ic/h-agl-ft"] = above
        _evaluate(fdm)
        clear = min(wheel.get_double_value() for wheel in wheels)
        if clear > 0:  # 0 in the ground, too
            break
    fdm["ic/h-agl-ft"] = above - clear + _DROP / FT
    _evaluate(fdm)
    for name, number in {**INTEGRATORS, **ON_WHEELS}.items():  # run_ic resets them
        fdm[f"simulation/integrator/{name}"] = number
    set_wind(fdm, np.asarray(condition.wind_n))


def come_to_rest(fdm: Any, say: Say = keep_quiet) -> None:
    """Let the model settle on the ground.

    Raises
    ------
    FlightError
        When it does not come to rest.
    """
    steps = round(1.0 / fdm.get_delta_t())
    for _ in range(_PATIENCE):
        for k in range(round(_SETTLE / fdm.get_delta_t())):
            if k % steps == 0:
                say("coming to rest on its wheels")
            fdm.run()
        moves = FT * max(abs(fdm[f"velocities/v-{axis}-fps"]) for axis in ("north", "east", "down"))
        if moves < _AT_REST:
            break
    else:
        raise FlightError(
            f"aircraft {fdm.get_model_name()} does not stand: it moves at {moves:.2g} m/s on its wheels"
        )


def _evaluate(fdm: Any) -> None:
    fdm.run_ic()
    wait(fdm, 1)
