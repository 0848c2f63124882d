"""A JSBSim script flown as it is, to its end."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

from bench.data import Trajectory
from bench.errors import FlightError
from bench.flight import sanity
from bench.flight.foreign import copy_aircraft, copy_script, executive
from bench.flight.model import one_line, silent_log
from bench.flight.recorder import simulation_step
from bench.flight.shaping import GUIDANCE_RATE
from bench.flight.tape import Tape, motion_of, motion_of_cg, pieces, truth_of, with_air
from bench.specs import ScriptSpec, stream

LONGEST = 4 * 3600.0
"""A script that runs longer is not flown without a duration [s]."""


def fly_pieces(spec: ScriptSpec, progress: Callable[[float], None], seconds: float) -> Iterator[Trajectory]:
    """Fly a script, with the working directory as scratch folder; the same script gives the same bits.

    Parameters
    ----------
    spec : ScriptSpec
        The script; its rate is a multiple of 20 Hz.
    progress : callable
        Called with the time flown so far [s].
    seconds : float
        Length of a piece [s].

    Returns
    -------
    iterator of Trajectory
        Truth at spec.rate in pieces. Events of kind "sanity" say what no aircraft of its class does,
        and which part of the script is truth where it puts the aircraft elsewhere.

    Raises
    ------
    FlightError
        When the script cannot be loaded or no truth can be made of it.
    """
    what = f"script {spec.name}"
    substeps, dt = simulation_step(spec.rate)
    try:
        tape = _run(spec, dt, progress)
    except FlightError as error:
        text = str(error)
        raise FlightError(text if text.startswith(("script", "aircraft")) else f"{what}: {text}") from None
    columns = tape.columns()
    raw = motion_of_cg(dt, columns)
    steps, events = sanity.stretch(dt, raw, what)
    per_tick = round(1.0 / (GUIDANCE_RATE * dt))
    begun = math.ceil(steps.start / per_tick)  # truth begins on a tick
    first = begun * per_tick
    motion = motion_of(dt, columns[first : steps.stop])
    ticks = tape.ticks().between(begun, (steps.stop - 1) // per_tick + 1)
    events += sanity.report(motion, ticks, spec.category)
    end = (len(motion.epa) - 2) // substeps * substeps * dt
    events.append((0.0, end, "leg", f"script {spec.name}"))
    return pieces(with_air(truth_of(motion, substeps, events), ticks), seconds)


def _run(spec: ScriptSpec, dt: float, progress: Callable[[float], None]) -> Tape:
    fdm = load(spec, dt)
    tape = Tape(fdm, dt)
    tape.step()
    tape.tick()
    per_tick = round(1.0 / (GUIDANCE_RATE * dt))
    last = math.inf if spec.duration is None else round(spec.duration / dt)
    begin = fdm.get_sim_time()
    while len(tape) < last and _goes_on(fdm, tape):
        tape.step()
        done = len(tape)
        if done % per_tick == 0:
            tape.tick()
            if abs(fdm.get_sim_time() - begin - done * dt) > 0.5 * dt:
                raise FlightError(
                    f"it changes its own time at {done * dt:.2f} s; no truth can be made of that"
                )
            progress(done * dt)
    if spec.duration is not None and len(tape) < last:
        raise FlightError(f"it ends at {len(tape) * dt:g} s; duration is {spec.duration:g} s")
    return tape


def _goes_on(fdm: Any, tape: Tape) -> bool:
    try:
        return bool(fdm.run())
    except RuntimeError as error:
        reason = one_line(str(error), str(Path.cwd()))
        raise FlightError(f"JSBSim stops at {len(tape) * tape.dt:.2f} s: {reason}") from None


def load(spec: ScriptSpec, dt: float) -> Any:
    """Return a new, silent FGFDMExec with the script and its aircraft, at its start, at step dt [s].

    Raises
    ------
    FlightError
        When it is missing, unsafe or JSBSim cannot read it.
    """
    scratch = Path.cwd()
    what, log = f"script {spec.name}", silent_log()
    copy = scratch / "scripts" / "script.xml"
    facts = copy_script(spec.path, copy)
    if spec.duration is None and not facts.length <= LONGEST:
        raise FlightError(
            f"it runs for {facts.length:g} s, longer than {LONGEST:g} s; duration_s stops it earlier"
        )
    copy_aircraft(spec.root / "aircraft" / facts.aircraft, scratch / "aircraft" / facts.aircraft)
    fdm = executive(scratch, spec.root, dt, log)
    fdm["simulation/randomseed"] = int(stream(spec.turbulence_seed, 0, "turbulence").integers(1, 2**31 - 1))
    try:
        loaded = fdm.load_script(str(copy), dt) and fdm.run_ic()
    except RuntimeError as error:
        raise FlightError(f"{what}: {one_line(str(error), str(scratch))}") from None
    if not loaded:
        raise FlightError(f"{what}: JSBSim cannot load it: {one_line(' '.join(log.lines), str(scratch))}")
    log.lines.clear()
    return fdm
