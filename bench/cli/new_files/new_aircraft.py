"""The verb new aircraft: gains of a foreign aircraft, written only if an acceptance flight succeeds."""

from __future__ import annotations

import json
import math
import os
import textwrap
from collections.abc import Callable, Iterator, Mapping
from concurrent.futures import ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from dataclasses import dataclass, replace
from multiprocessing import get_context
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
from rich.console import Console

from bench.core.files import durable
from bench.core.files.spawned import count_work, measure_cpu
from bench.core.mathematics.arrays import FloatArray
from bench.core.mathematics.rotation import to_euler
from bench.core.mathematics.units import STANDARD_GRAVITY
from bench.core.records.data import Trajectory
from bench.core.records.flight_specs import AircraftSpec, ForeignSpec
from bench.core.words.exceptions import ConfigError, FlightError
from bench.core.words.wording import suggest
from bench.io.config.external_truth import find_jsbsim_root, has_guidance, list_root_aircraft
from bench.io.config.library import read_jsbsim_aircraft
from bench.io.config.listing import JSBSIM, NAME, list_aircraft_folders
from bench.simulation.flight.child_process import fly_in_child
from bench.simulation.flight.guidance.gain_design import (
    BANK,
    FASTER,
    GainDesign,
    attempts,
    design_gains,
    plan_acceptance,
    prepare_aircraft,
)

_Result = TypeVar("_Result")
_PATTERN = "c172x"  # where what is not designed comes from: the guidance system
PATIENCE = 120.0  # CPU time for a design, or time without any [s]; a model of others may never return
LOOK = 0.5  # time between two looks at it [s]
_BEGUN = 12.0  # after the start of a leg, in which it is settled [s]
_LAST = 15.0  # of a straight leg in which nothing may swing any more [s]

BANK_BAND, HEIGHT_BAND, SPEED_BAND = math.radians(4.0), 15.0, 0.05
LOAD_BAND = (0.65, 1.4)
SWING_BAND = math.radians(0.5)
"""What a flight is accepted by: bank off [rad], height off [m], airspeed off [1], load [g], swing [rad]."""


@dataclass(frozen=True, slots=True)
class Acceptance:
    """Largest deviations of the acceptance flight."""

    bank: float  # [rad]
    height: float  # [m], 0 of a glider
    speed: float  # as a share
    load: tuple[float, float]  # [g]
    swing: float  # of bank and pitch at the end of 30 s straight, sd [rad]

    def failures(self) -> list[str]:
        """Return the deviations outside their limits in words."""
        rows = (
            (self.bank > BANK_BAND, f"bank {math.degrees(self.bank):.1f} deg off"),
            (self.height > HEIGHT_BAND, f"height {self.height:.0f} m off"),
            (self.speed > SPEED_BAND, f"airspeed {100 * self.speed:.1f} % off"),
            (self.load[0] < LOAD_BAND[0] or self.load[1] > LOAD_BAND[1], f"load {self.describe_load()}"),
            (self.swing > SWING_BAND, f"swings by {math.degrees(self.swing):.1f} deg"),
        )
        return [words for wrong, words in rows if wrong]

    def describe_load(self) -> str:
        """Return the range of the load in words."""
        return f"{self.load[0]:.2f} to {self.load[1]:.2f}"

    def describe(self) -> str:
        """Return the deviations in words."""
        return (
            f"bank within {math.degrees(self.bank):.1f} deg, height {self.height:.1f} m, airspeed "
            f"{100 * self.speed:.1f} %, load {self.describe_load()}, swing {math.degrees(self.swing):.2f} deg"
        )


def new_aircraft(name: str, *, console: Console) -> None:
    """Design the gains of an aircraft, fly it, and write its ``.toml`` if it is accepted.

    A name is that of an aircraft of the jsbsim wheel, whose file is ``aircraft/jsbsim/NAME.toml``; a folder,
    with a slash in it, is that of a model of your own, and the file its ``aircraft.toml``.

    Raises
    ------
    ConfigError
        If there is no such aircraft, no profile would find it, or the file is there already.
    FlightError
        If it does not load, or no design is accepted: the reason of the best one.
    """
    raw, path, shown = _find_own(Path(name)) if {"/", os.sep} & set(name) else find_shipped(name)
    if path.exists() or path.is_symlink():
        raise ConfigError(f"{path}: exists already and is not replaced")
    design, accepted, flown = find_design(raw, lambda text: console.print(text, soft_wrap=True))
    path.parent.mkdir(parents=True, exist_ok=True)
    durable.write(path, write_sheet(flown, design, accepted, shown))
    console.print(f"{shown}: trimmed at {design.speed:g} m/s, {design.alt:g} m; {accepted.describe()}")
    if stubs := _foreign_of(flown).stubs:
        console.print(
            f"The model reads what it does not have; 0 stands for: {', '.join(stubs)}", soft_wrap=True
        )
    beside = path.absolute().parents[1]
    console.print(f'Wrote {path}. Next: a profile beside {beside} with aircraft = "{shown}"', soft_wrap=True)


def find_shipped(name: str) -> tuple[AircraftSpec, Path, str]:
    """Return an aircraft of the wheel, its file, and its name in a profile."""
    name = name.removeprefix(JSBSIM)
    root = find_jsbsim_root(None, Path())
    known = list_root_aircraft(root)
    if name not in known:
        if Path(name).is_dir():
            raise ConfigError(f"aircraft = {JSBSIM + name!r} is not in the wheel; the folder is ./{name}")
        hint = suggest(name, known, "aircraft")
        raise ConfigError(f"aircraft = {JSBSIM + name!r} is not in the wheel{hint}")
    return _make_raw(root / "aircraft" / name, root), Path("aircraft/jsbsim") / f"{name}.toml", JSBSIM + name


def _find_own(folder: Path) -> tuple[AircraftSpec, Path, str]:
    """Return the aircraft of a folder, its file, and its name in a profile beside ``aircraft/``."""
    here = Path(os.path.abspath(folder))
    name = here.name
    if not NAME.fullmatch(name):
        raise ConfigError(f"{folder}: its name must be letters, digits, '-' and '_', 100 at most")
    model = folder / f"{name}.xml"
    if not os.path.isfile(model):
        raise ConfigError(f"{model}: no such file; the model of a folder has its name")
    if has_guidance(model):
        raise ConfigError(
            f"{model}: it has the guidance system of the bench; write its aircraft.toml by hand"
        )
    if here.parent.name != "aircraft" or here.parent in list_aircraft_folders():
        where = f"a profile finds it as aircraft/{name} beside itself, outside the bench"
        raise ConfigError(f"{folder}: must lie in a folder of yours that is named aircraft: {where}")
    return _make_raw(here, find_jsbsim_root(None, Path())), folder / "aircraft.toml", name


def _make_raw(folder: Path, root: Path) -> AircraftSpec:
    """Return an aircraft without known limits, with engines and systems of a JSBSim root."""
    return replace(
        read_jsbsim_aircraft(_PATTERN, None, Path()),
        name=folder.name,
        folder=folder,
        foreign=ForeignSpec(root, {}),
        trims=(),
        runway=None,
        configuration=(),
    )


def find_design(
    raw: AircraftSpec, tell: Callable[[str], object] = lambda text: None
) -> tuple[GainDesign, Acceptance, AircraftSpec]:
    """Return the first accepted design of an aircraft, and the aircraft with this design.

    ``tell`` is called with the reason of each that is not. What no design can change ends the search.
    """
    raw = run_in_child(raw.name, "loaded", prepare_aircraft, raw)
    reason, fewest = "", 99
    for attempt in attempts(glides=raw.glides):
        try:
            design = run_in_child(raw.name, "trimmed", design_gains, raw, *attempt)
        except FlightError as error:
            reason = reason or str(error)
            tell(str(error))
            continue
        aircraft = equip(raw, design)
        try:
            accepted = measure_acceptance(_fly(aircraft, design), design, glides=aircraft.glides)
        except FlightError as error:
            reason = reason or str(error)
            tell(str(error))
            continue
        if not (failures := accepted.failures()):
            return design, accepted, aircraft
        said = f"flown at {design.speed:g} m/s, not accepted: {', '.join(failures)}"
        tell(said)
        if len(failures) < fewest:
            fewest, reason = len(failures), said
    raise FlightError(reason if reason.startswith("aircraft") else f"aircraft {raw.name}: {reason}")


def run_in_child(name: str, done: str, work: Callable[..., _Result], *arguments: Any) -> _Result:
    """Return the result of a call in a child process, because a model may crash or hang it."""
    with ProcessPoolExecutor(1, mp_context=get_context("spawn")) as pool:
        answer, spent, used = pool.submit(work, *arguments), 0.0, 0.0
        (child,) = pool._processes.values()
        while spent < PATIENCE:
            try:
                return answer.result(timeout=LOOK)
            except BrokenProcessPool:
                raise FlightError(f"aircraft {name}: JSBSim ends the process while it is {done}") from None
            except TimeoutError:
                before, used = used, measure_cpu(child.pid or 0)
                spent += count_work(before, used, LOOK)
        child.kill()
        raise FlightError(f"aircraft {name}: not {done} within {PATIENCE:g} s of CPU time")


def equip(raw: AircraftSpec, design: GainDesign) -> AircraftSpec:
    """Return an aircraft with the gains of a design and the limits of its speed."""
    heavy = design.mass > 15_000
    return replace(
        raw,
        gains=dict(design.gains),
        min_speed=0.9 * design.speed,
        max_speed=1.15 * design.speed,
        max_bank=math.radians(30.0),
        max_climb=design.climb,
        max_descent=design.climb,
        antenna_b=(0.0, 0.0, -0.05 * design.span),
        category="transport" if heavy else "light",
        trims=((design.alt, design.speed),),
    )


def _foreign_of(aircraft: AircraftSpec) -> ForeignSpec:
    assert aircraft.foreign is not None
    return aircraft.foreign


def _fly(aircraft: AircraftSpec, design: GainDesign) -> Trajectory:
    spec = plan_acceptance(aircraft, design)
    (truth,) = fly_in_child(spec, f"aircraft {aircraft.name}")
    return truth


def measure_acceptance(truth: Trajectory, design: GainDesign, *, glides: bool = False) -> Acceptance:
    """Return the largest deviations of the acceptance flight from the commands of its legs.

    A glider has no height to hold.
    """
    roll, pitch, _ = to_euler(truth.q_nb)
    alt, air = truth.lla[:, 2], truth.air
    load = -truth.dvel_b[:, 2] / np.diff(truth.t) / STANDARD_GRAVITY
    bank = height = speed = swing = 0.0
    for number, (start, end, _) in enumerate(truth.events.select("leg")):
        settled = (truth.t >= start + _BEGUN) & (truth.t <= end)
        asked = design.speed * (FASTER if number == 6 else 1.0)
        if number != 5:
            inside = (air.t >= start) & (air.t < end)
            speed = max(speed, float(np.abs(air.airspeed_true[inside] / asked - 1).max()))
        banked = {0: 0.0, 1: BANK, 6: 0.0} | ({3: -BANK} if glides else {})  # 2 and 4 roll out of a circle
        if settled.any() and number in banked:
            off = np.abs(roll[settled] - banked[number])
            bank = max(bank, float(off[: -_tail(truth, 6.0)].max() if banked[number] else off.max()))
        if number in (0, 1, 2, 6) and not glides:
            whole = (truth.t >= start) & (truth.t <= end)
            height = max(height, float(np.abs(alt[whole] - design.alt).max()))
        if number in (0, 6):
            last = (truth.t >= end - _LAST) & (truth.t <= end)
            swing = max(swing, *(_swing(truth.t[last], angle[last]) for angle in (roll, pitch)))
    return Acceptance(bank, height, speed, (float(load.min()), float(load.max())), swing)


def _swing(t: FloatArray, angle: FloatArray) -> float:
    """Return the sd of an angle about its slow change, a straight line [rad]."""
    line = np.polynomial.Polynomial.fit(t, angle, 1)
    return float(np.std(angle - line(t)))


def _tail(truth: Trajectory, seconds: float) -> int:
    return round(seconds / float(truth.t[1]))


def write_sheet(aircraft: AircraftSpec, design: GainDesign, accepted: Acceptance, shown: str) -> str:
    """Return the ``.toml`` of a design; ``shown`` is its name in a profile."""
    return "\n".join(_sheet_lines(aircraft, design, accepted, shown)) + "\n"


def _sheet_lines(
    aircraft: AircraftSpec, design: GainDesign, accepted: Acceptance, shown: str
) -> Iterator[str]:
    of_wheel = shown.startswith(JSBSIM)
    whose = "of JSBSim" if of_wheel else "as its folder has it"
    rest = "; the model and its license stay with JSBSim" if of_wheel else ""
    yield f"# Found by bench new aircraft for {shown}{rest}."
    trim = design.trim
    glides = aircraft.glides
    words = (
        f"Trim: alpha {math.degrees(trim.alpha):.2f} deg, elevator {trim.elevator:.3f}, throttle "
        f"{trim.throttle:.3f}. Flown: 30 s straight, 360 deg at 20 deg of bank, "
        f"{'the same to the left' if glides else '150 m up and down'}, "
        f"6 % faster: {accepted.describe()}. Linear, in rad/s^2 or m/s^2 per unit of command, rad or rad/s: "
        f"{_list(design.derivatives)}."
    )
    yield from textwrap.wrap(words, 108, initial_indent="# ", subsequent_indent="# ")
    yield f'title    = "{aircraft.name} {whose}, {design.mass:.0f} kg"'
    yield f'class    = "{aircraft.category}"'
    if glides:
        yield f'kind     = "{aircraft.kind}"  # no engine: it holds its airspeed by pitch and sinks'
    package = "the jsbsim package; its model names its own sources" if of_wheel else "its model"
    yield f'source   = "{package}"'
    yield 'assumed  = ["limits", "antenna", "guidance"]'
    foreign = _foreign_of(aircraft)
    if foreign.stubs:
        yield f"stubs    = {json.dumps(list(foreign.stubs))}  # read by the model and not there: 0"
    yield "\n[limits]"
    yield f"min_speed_mps   = {aircraft.min_speed:.1f}"
    yield f"max_speed_mps   = {aircraft.max_speed:.1f}"
    yield f"max_bank_deg    = {math.degrees(aircraft.max_bank):.0f}"
    yield f"max_climb_mps   = {aircraft.max_climb:.2f}"
    yield f"max_descent_mps = {aircraft.max_descent:.2f}"
    yield f"\n[[trim]]\nalt_m     = {design.alt:.1f}\nspeed_mps = {design.speed:.1f}"
    yield "\n[antenna]                    # assumed: above the fuselage"
    yield f"forward_m = 0.0\nright_m   = 0.0\ndown_m    = {aircraft.antenna_b[2]:.2f}"
    if foreign.properties:
        yield "\n[properties]                 # set before the start"
        for key, value in foreign.properties.items():
            yield f'"{key}" = {value:.1f}'
    yield "\n[guidance]"
    for key, value in design.gains.items():
        yield f"{key} = {value:.6g}"


def _list(values: Mapping[str, float]) -> str:
    return ", ".join(f"{name} {value:.3g}" for name, value in values.items())
