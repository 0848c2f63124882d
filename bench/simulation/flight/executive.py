"""JSBSim with an aircraft or a script, loaded from a safe temporary copy.

Aircraft of the bench have the guidance system in their model. To a copy of any other the loader adds it:
its engines take fcs/throttle-cmd-norm, one for each, which is one more output of guidance, and its start
may need properties of its own (mixture, gear up).
"""

from __future__ import annotations

import ctypes
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

from bench.core.files.scratch import PREFIX, make_scratch
from bench.core.mathematics.random_streams import stream
from bench.core.records.flight_specs import GLIDER, AircraftSpec, ScriptSpec
from bench.core.words.exceptions import FlightError
from bench.simulation.flight.model_files import (
    LONGEST_SCRIPT,
    NAME,
    copy_aircraft,
    copy_script,
    count_engines,
    read_xml,
    write_xml,
)

_SCRATCH_PATH = re.compile(rf"[^\s\"'<>]*/{re.escape(PREFIX)}[^/\s]*/")
_PROPERTY = re.compile(r"[A-Za-z0-9_/.\[\]-]+")
_THROTTLE = "guidance/throttle-cmd-norm"
_CONTROLS = ("system", "autopilot", "flight_control")


def load_aircraft(aircraft: AircraftSpec, dt: float, *, rough: bool = False) -> Any:
    """Return a new, silent FGFDMExec with the aircraft and its guidance system, at step dt [s].

    ``rough`` takes the gains that the aircraft has for rough air.

    Raises
    ------
    FlightError
        When the model is missing, unsafe or JSBSim cannot read it.
    """
    import jsbsim

    foreign = aircraft.foreign
    root = foreign.root if foreign else Path(jsbsim.get_default_root_dir())

    def start(fdm: Any) -> bool:
        if not fdm.load_model(aircraft.name):
            return False
        for name, value in foreign.properties.items() if foreign else ():
            _check_property(aircraft, "[properties]", name)
            find_property(fdm, name).set_double_value(value)
        return bool(fdm.run_ic())  # a property that does not exist shows only here

    with make_scratch() as scratch:
        copy = scratch / "aircraft" / aircraft.name
        model = copy_aircraft(aircraft.name, aircraft.folder, copy)
        if not aircraft.guided:
            write_xml(_add_guidance(aircraft, model), copy / "guidance.xml")
            write_xml(model, copy / f"{aircraft.name}.xml")
        for named in model.findall("external_reactions[@file]"):
            _add_shared(aircraft.systems, named.get("file", ""), copy)
        systems = aircraft.systems if aircraft.guided else root / "systems"
        fdm = _start(scratch, root / "engine", systems, dt, f"aircraft {aircraft.name}", start)
    gains = {**aircraft.gains, **aircraft.rough_gains} if rough else aircraft.gains
    for name, gain in gains.items():
        if not NAME.fullmatch(name):
            raise FlightError(f"aircraft {aircraft.name}: [guidance] {name!r} is not the name of a gain")
        find_property(fdm, f"guidance/{name}").set_double_value(gain)
    fdm["guidance/bank-limit-rad"] = aircraft.max_bank
    if not aircraft.hovers:  # the paths of a multirotor keep within them by themselves
        fdm["guidance/climb-limit-mps"] = aircraft.max_climb
        fdm["guidance/descent-limit-mps"] = aircraft.max_descent
    return fdm


def load_script(spec: ScriptSpec, dt: float) -> Any:
    """Return a new, silent FGFDMExec with the script and its aircraft, at its start, at step dt [s].

    Raises
    ------
    FlightError
        When it is missing, unsafe or JSBSim cannot read it.
    """
    what = f"script {spec.name}"
    with make_scratch() as scratch:
        copy = scratch / "scripts" / "script.xml"
        script = copy_script(spec.path, copy)
        if spec.duration is None and not script.length <= LONGEST_SCRIPT:
            raise FlightError(
                f"{what}: it runs for {script.length:g} s, longer than {LONGEST_SCRIPT:g} s; "
                f"duration_s stops it earlier"
            )
        aircraft = Path("aircraft") / script.aircraft
        copy_aircraft(script.aircraft, spec.root / aircraft, scratch / aircraft)

        def start(fdm: Any) -> bool:
            seed = stream(spec.turbulence_seed, 0, "turbulence").integers(1, 2**31 - 1)
            fdm["simulation/randomseed"] = int(seed)
            return bool(fdm.load_script(str(copy), dt) and fdm.run_ic())

        return _start(scratch, spec.root / "engine", spec.root / "systems", dt, what, start)


def _start(
    scratch: Path, engines: Path, systems: Path, dt: float, what: str, start: Callable[[Any], bool]
) -> Any:
    """Return an executive that reads aircraft from the scratch folder, after ``start`` has loaded one."""
    import jsbsim

    log = silent_log()
    jsbsim.set_logger(log)
    fdm = jsbsim.FGFDMExec(str(scratch))
    fdm.set_debug_level(0)
    fdm.set_aircraft_path(str(scratch / "aircraft"))
    fdm.set_engine_path(str(engines))
    fdm.set_systems_path(str(systems))
    fdm.set_output_path(str(scratch))
    fdm.set_dt(dt)
    try:
        if start(fdm):
            log.lines.clear()
            return fdm
        reason = f"JSBSim cannot load it: {say_in_one_line(' '.join(log.lines))}"
    except RuntimeError as error:
        reason = say_in_one_line(str(error))
    # kept for good: the destructor of a broken model may throw and end the process
    ctypes.pythonapi.Py_IncRef(ctypes.py_object(fdm))
    raise FlightError(f"{what}: {reason}")


def _add_guidance(aircraft: AircraftSpec, model: ElementTree.Element) -> ElementTree.Element:
    """Add ``<system file="guidance"/>`` to a model, before every other control; return the system.

    It has an output to the throttle of every engine.
    """
    engines = count_engines(model)
    if not engines and not aircraft.glides:
        raise FlightError(
            f"aircraft {aircraft.name}: it has no engine to hold a speed with; is it of kind = {GLIDER!r}?"
        )
    if not any(system.get("file") == "guidance" for system in model.findall("system")):
        first = next((k for k, child in enumerate(model) if child.tag in _CONTROLS), None)
        if first is None:
            raise FlightError(f"aircraft {aircraft.name}: it has no <flight_control> to fly it by")
        model.insert(first, ElementTree.Element("system", {"file": "guidance"}))
    guidance = read_xml(aircraft.systems / "guidance.xml", "guidance.xml")
    for name in aircraft.foreign.stubs if aircraft.foreign else ():
        _check_property(aircraft, "stubs", name)
        stub = ElementTree.Element("property", {"value": "0"})
        stub.text = name
        guidance.insert(0, stub)
    for component in guidance.iter():
        if any((output.text or "").strip() == _THROTTLE for output in component.findall("output")):
            for n in range(engines):
                ElementTree.SubElement(component, "output").text = f"fcs/throttle-cmd-norm[{n}]"
    return guidance


def _add_shared(systems: Path, name: str, copy: Path) -> None:
    """Add to a copied aircraft the external reactions that it names and that lie in the systems folder."""
    file = f"{name}.xml"
    if not (copy / file).is_file() and (systems / file).is_file():  # JSBSim looks in the aircraft folder
        write_xml(read_xml(systems / file, file), copy / file)


def _check_property(aircraft: AircraftSpec, key: str, name: str) -> None:
    if not _PROPERTY.fullmatch(name):
        raise FlightError(f"aircraft {aircraft.name}: {key} {name!r} is not a property")


def find_property(fdm: Any, name: str) -> Any:
    """Return a property of the model by its JSBSim name.

    Raises
    ------
    FlightError
        When the model does not have it.
    """
    found = fdm.get_property_manager().get_node(name)
    if found is None:
        raise FlightError(f"aircraft {fdm.get_model_name()}: the model has no property {name}")
    return found


def silent_log() -> Any:
    """Return a logger that keeps the messages of JSBSim and prints nothing."""
    import jsbsim

    class FlightLog(jsbsim.DefaultLogger):
        def __init__(self) -> None:
            super().__init__()
            self.lines: list[str] = []

        def message(self, message: str) -> None:
            if not message.isspace() and "JSBSim startup" not in message:
                self.lines.append(message)

        def file_location(self, filename: str, line: int) -> None:
            self.lines.append(f"{filename}:{line}:")

        def format(self, format: Any) -> None:  # noqa: A002 (the name JSBSim calls)
            pass

        def flush(self) -> None:
            pass

    return FlightLog()


def say_in_one_line(text: str) -> str:
    """Return a message of JSBSim as one line, without the scratch folder."""
    return " ".join(_SCRATCH_PATH.sub("", text).split())[:300] or "no reason given"
