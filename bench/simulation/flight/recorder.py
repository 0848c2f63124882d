"""Fly a plan or a script in JSBSim, record its states, and compute the truth from the states.

JSBSim steps at the smallest multiple of the truth rate that is at least 400 Hz, a script at least as often as
it asks for. Air data, controls and the sequencer run at 20 Hz. What was not made for the bench has a sanity
report, a plan its exceedances.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator
from dataclasses import replace
from typing import Any, TypeVar

from bench.core.records.data import EventRow, Trajectory
from bench.core.records.flight_specs import FlightSpec, ScriptSpec
from bench.core.words.exceptions import FlightError
from bench.simulation.flight.exceedances import Exceedances
from bench.simulation.flight.executive import load_aircraft, load_script, say_in_one_line
from bench.simulation.flight.ground.roughness import over_rough_ground
from bench.simulation.flight.guidance.belief import Belief
from bench.simulation.flight.guidance.sequencer import Cockpit, FlownLeg, engage, fly_legs
from bench.simulation.flight.guidance.shaping import GUIDANCE_RATE
from bench.simulation.flight.hover_trim import prepare_hover
from bench.simulation.flight.jsbsim_units import FT
from bench.simulation.flight.model_files import script_facts
from bench.simulation.flight.rotor_cockpit import RotorCockpit
from bench.simulation.flight.sanity import choose_flight, report_sanity
from bench.simulation.flight.standing import stand
from bench.simulation.flight.state_log import NEIGHBORS, StateLog
from bench.simulation.flight.trimming import Say, TrimCondition, keep_quiet, settle, trim_aircraft
from bench.simulation.flight.truth import Stretch, make_truth
from bench.simulation.flight.turbulence.dryden import through_turbulence
from bench.simulation.flight.turbulence.wind import Weather
from bench.simulation.signals.terrain import ground_at

_Part = TypeVar("_Part")

PIECE = 30.0
"""How much of a flight is kept in memory at a time [s]."""

_LEAST_RATE = 400.0  # of JSBSim [Hz]
_FINEST = 0.5e-3  # a script that asks for shorter steps gets this one [s]
_CLEAR = 50.0  # wheels off the ground for the trim of a flight that starts on it [m]

Progress = Callable[[float], None]
"""Called with the time flown so far [s]."""


def fly_pieces(
    spec: FlightSpec | ScriptSpec,
    progress: Progress | None = None,
    seconds: float = PIECE,
    say: Say = keep_quiet,
    belief: Belief | None = None,
) -> Iterator[Trajectory]:
    """Fly and yield the truth in pieces, so that a long flight needs no more memory than a short one.

    The same spec gives the same bits in any process, and pieces put together those of the whole.

    Parameters
    ----------
    spec : FlightSpec or ScriptSpec
        The plan, or the script; its rate is a multiple of 20 Hz.
    progress : callable, optional
        Called with the time flown so far [s].
    seconds : float
        Length of a piece [s].
    say : callable
        Called with what is done before and after the flight.
    belief : Belief, optional
        What guidance and legs believe, of a plan. Who takes a piece changes it before asking for the next;
        each comes 50 ms after the time at which it ends. A flight that fails then ends there, with an
        event of kind "crash".

    Yields
    ------
    Trajectory
        Truth at spec.rate from t = 0, of the IMU, as `make_truth` yields it; the flown legs are events of
        kind "leg". Events of kind "sanity" report motion beyond the limits of the class, events of kind
        "exceedance" runway excursions, hard landings, stalls and overspeed.

    Raises
    ------
    FlightError
        When it cannot be loaded, trimmed, or flown as planned, or no truth can be made of it.
    """
    if isinstance(spec, ScriptSpec):
        stretches = report_sanity(record_script(spec, progress, seconds, say), spec.category)
    else:
        stretches = record_plan(spec, progress, seconds, say, belief)
        if not spec.aircraft.guided:
            stretches = report_sanity(stretches, spec.aircraft.category, landings=False)
    return make_truth(stretches, spec.rate)


def record_plan(
    spec: FlightSpec,
    progress: Progress | None = None,
    seconds: float = PIECE,
    say: Say = keep_quiet,
    belief: Belief | None = None,
) -> Iterator[Stretch]:
    """Fly a plan and yield it in segments; parameters and errors as for :func:`fly_pieces`."""
    _, dt = simulation_step(spec.rate)
    fdm, cockpit = prepare(spec, dt, say, belief)
    craft = spec.aircraft
    kind = {"guided": craft.guided, "hovers": craft.hovers, "glides": craft.glides}
    four = craft.has_four_rotors
    log = StateLog(fdm, dt, f"aircraft {craft.name}", craft.imu_b, **kind, four_rotors=four)
    exceedances = Exceedances(spec, fdm, taxiways=cockpit.taxiways)
    run = over_rough_ground(fdm, cockpit, spec, dt, through_turbulence(fdm, spec, dt))
    keep_state = log.keep_state
    shares = [k / log.per_tick for k in range(1, log.per_tick + 1)]
    flown: list[FlownLeg] = []
    ended: list[EventRow] = []
    keep_state()
    try:
        for t in fly_legs(cockpit, spec, flown, Weather(fdm, spec)):
            log.keep_air()
            if belief is not None:
                belief.begin_tick(t)
            for share in shares:
                if belief is not None:
                    belief.step(share)
                run()
                keep_state()
            yield from map(exceedances.add, log.cut(seconds, kept=0 if belief else 1))
            if progress is not None and t % 1.0 == 0.0:
                progress(t)
    except FlightError as error:
        if belief is None or not flown or not flown[-1].end:
            raise
        ended = [(flown[-1].end, flown[-1].end, "crash", str(error))]
    log.keep_air()
    for _ in range(NEIGHBORS):
        run()
        keep_state()
    rest = exceedances.add(log.cut_rest([]))
    legs = ((leg.start, leg.end, "leg", leg.text) for leg in flown)
    yield replace(rest, events=[*legs, *ended, *exceedances.rows()])


def record_script(
    spec: ScriptSpec, progress: Progress | None = None, seconds: float = PIECE, say: Say = keep_quiet
) -> Iterator[Stretch]:
    """Fly a script to its end and yield its usable part in segments.

    Its states stay in memory until the end, which shows the part; the rest is as for :func:`record_plan`.
    """
    what = f"script {spec.name}"
    substeps, dt = simulation_step(spec.rate, max(script_facts(spec.path).step, _FINEST))
    say("loading")
    log = run_script(spec, what, dt, progress)
    steps, events = choose_flight(_tell(log.motions_of_center(), say, "looking at its motion"), what)
    log.leave_out(math.ceil(steps.start / log.per_tick), steps.stop)  # truth begins on a tick
    end = (log.count_steps() - NEIGHBORS) // substeps * substeps * dt
    yield from _tell(log.cut(seconds), say, "making its truth")
    yield log.cut_rest([*events, (0.0, end, "leg", what)])


def _tell(parts: Iterable[_Part], say: Say, doing: str) -> Iterator[_Part]:
    """Yield parts, and report the activity before each part."""
    say(doing)
    for part in parts:
        say(doing)
        yield part


def run_script(spec: ScriptSpec, what: str, dt: float, progress: Progress | None) -> StateLog:
    """Run a script of JSBSim and return its states."""
    fdm = load_script(spec, dt)
    log = StateLog(fdm, dt, what)
    log.keep_state()
    log.keep_air()
    last = math.inf if spec.duration is None else round(spec.duration / dt)
    begin = fdm.get_sim_time()
    done = 0
    while done < last and _step_script(fdm, what, done * dt):
        log.keep_state()
        done += 1
        if done % log.per_tick == 0:
            log.keep_air()
            if abs(fdm.get_sim_time() - begin - done * dt) > 0.5 * dt:
                raise FlightError(
                    f"{what}: it changes its own time at {done * dt:.2f} s; no truth can be made of that"
                )
            if progress is not None:
                progress(done * dt)
    if spec.duration is not None and done < last:
        raise FlightError(f"{what}: it ends at {done * dt:g} s; duration is {spec.duration:g} s")
    return log


def _step_script(fdm: Any, what: str, t: float) -> bool:
    try:
        return bool(fdm.run())
    except RuntimeError as error:
        raise FlightError(f"{what}: JSBSim stops at {t:.2f} s: {say_in_one_line(str(error))}") from None


def simulation_step(rate: float, longest: float = 1.0 / _LEAST_RATE) -> tuple[int, float]:
    """Return the steps per truth sample and the step [s], at most 1/400 s and ``longest`` [s].

    Examples
    --------
    >>> simulation_step(200.0)
    (2, 0.0025)

    Raises
    ------
    FlightError
        When rate is not a multiple of 20 Hz, the rate of set-points and air data.
    """
    if rate <= 0 or rate % GUIDANCE_RATE:
        raise FlightError(f"a truth rate of {rate:g} Hz is not a multiple of {GUIDANCE_RATE:g} Hz")
    substeps = max(1, math.ceil(max(_LEAST_RATE, 1.0 / longest) / rate - 1e-9))
    return substeps, 1.0 / (rate * substeps)


def prepare(
    spec: FlightSpec, dt: float, say: Say = keep_quiet, belief: Belief | None = None
) -> tuple[Any, Cockpit | RotorCockpit]:
    """Return the model and its guidance at the start of the plan, in wind, trimmed or standing."""
    say("loading")
    fdm = load_aircraft(spec.aircraft, dt, rough=spec.severity >= spec.aircraft.rough_from)
    guided = spec.aircraft.guided
    ground = spec.ground_alt if spec.terrain is None else ground_at(spec.terrain, spec.lat, spec.lon)
    fdm["ic/terrain-elevation-ft"] = float(ground) / FT
    north, east, down = (float(v) for v in Weather(fdm, spec).wind_at(spec.alt))
    condition = TrimCondition(
        spec.lat, spec.lon, spec.alt, spec.heading, spec.speed, wind_n=(north, east, down)
    )
    if spec.aircraft.hovers:
        return fdm, prepare_hover(fdm, spec, condition, say)
    glides = spec.aircraft.glides
    if spec.on_ground:  # trimmed for the climb to come
        above = replace(condition, alt=spec.alt + _CLEAR)
        trimmed = trim_aircraft(fdm, above, guided=guided, glides=glides, say=say)
        stand(fdm, condition, guided=guided, held=glides, say=say)
    else:
        trimmed = trim_aircraft(fdm, condition, guided=guided, glides=glides, say=say)
        say("settling")
        settle(fdm)
    cockpit = engage(fdm, spec, trimmed, belief)
    return fdm, cockpit
