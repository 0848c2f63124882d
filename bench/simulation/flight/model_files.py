"""Safe copies of foreign JSBSim files, without elements that write files or open sockets.

``<output>`` writes any file the user can write, ``<input>`` opens ports, ``<notify>``
prints. Names go unchecked into paths: one that leaves the folder is rejected. So a model or script is read,
stripped and written into a scratch folder, and only that copy is loaded.
"""

from __future__ import annotations

import math
import re
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

from bench.core.words.exceptions import FlightError
from bench.simulation.flight.jsbsim_units import FT, POUND, SLUG

NAME = re.compile(r"[A-Za-z0-9_-]+")
"""Of an aircraft, or of a gain."""
LONGEST_SCRIPT = 4 * 3600.0
"""A script that runs longer is not flown without a duration [s]."""

_FILE = re.compile(r"[A-Za-z0-9_.-]+")
_WITHIN = re.compile(r"(?!\.+(/|$))[\w .+-]+(/(?!\.+(/|$))[\w .+-]+)*")  # the path of a file below a folder
_DEEPEST = 100  # elements within each other; the deepest file of the jsbsim wheel has 13
MOST_ELEMENTS = 2_000_000  # of one file; those of a track of 20 MB are fewer
_MOST_FILES = 500
_MOST_BYTES = 20_000_000  # of one file; the largest of the jsbsim wheel has 0.2 MB
_UNWANTED = ("input", "output")
_KILOGRAMS = {"KG": 1.0, "LBS": POUND, "SLUG": SLUG}
_INERTIAS = {"KG*M2": 1.0, "SLUG*FT2": SLUG * FT**2}
_ARMS = {"rotor/arm-forward-m": "rotor_forward", "rotor/arm-right-m": "rotor_right"}
_LIGHTEST = 150.0  # below it a state certifies what flies without a pilot on board, above it the EASA [kg]
_HEAVIEST = 19_000 * POUND  # above it an aeroplane is of the transport category, 14 CFR 25 [kg]
_AGILE = 30_000.0  # heavier ones with an afterburner are no fighters; assumed [kg]


def read_xml(path: Path, shown: str) -> ElementTree.Element:
    """Return the root of an XML file.

    Raises
    ------
    FlightError
        When it is missing, too large or too deep, not well-formed, or names a file outside of its folder.
    """
    try:
        if path.stat().st_size > _MOST_BYTES:
            raise FlightError(f"{shown}: larger than {_MOST_BYTES // 1_000_000} MB")
        root = ElementTree.parse(path, ElementTree.XMLParser(target=_ElementBuilder(shown))).getroot()
    except OSError as error:
        raise FlightError(f"{shown}: {error.strerror or error}") from None
    except (ElementTree.ParseError, ValueError, LookupError) as error:
        raise FlightError(f"{shown}: not well-formed XML: {error}") from None
    for element in root.iter():
        _check_references(element, shown)
    return root


class _ElementBuilder(ElementTree.TreeBuilder):
    """Builder of the elements of an XML file, with limits on their number and depth."""

    def __init__(self, shown: str) -> None:
        super().__init__()
        self._shown, self._count, self._depth = shown, 0, 0

    def start(self, tag: Any, attrs: Any, /) -> ElementTree.Element:
        """Begin an element."""
        self._count, self._depth = self._count + 1, self._depth + 1
        if self._depth > _DEEPEST:
            raise FlightError(f"{self._shown}: more than {_DEEPEST} elements within each other")
        if self._count > MOST_ELEMENTS:
            raise FlightError(f"{self._shown}: more than {MOST_ELEMENTS} elements")
        return super().start(tag, attrs)

    def end(self, tag: Any, /) -> ElementTree.Element:
        """End an element."""
        self._depth -= 1
        return super().end(tag)


def _check_references(element: ElementTree.Element, shown: str) -> None:
    """Reject an element that names a file or a child model outside of the folders of the aircraft."""
    for key in ("file", "name") if element.tag == "child" else ("file",):
        name = element.get(key)
        if name is not None and element.tag not in _UNWANTED and not _WITHIN.fullmatch(name.strip()):
            what = f"<{element.tag} {key}={name[:80]!r}>"
            raise FlightError(f"{shown}: {what} must name a file in the folder of the model")


def copy_aircraft(name: str, folder: Path, target: Path) -> ElementTree.Element:
    """Copy the XML files of an aircraft without ``<input>`` and ``<output>``, and return its model.

    Other kinds of file are left out. The copies are written from what was read, so that JSBSim sees the
    same names: a DOCTYPE is gone, a name in an XML namespace is unknown.

    Raises
    ------
    FlightError
        When the folder or one of its files cannot be used.
    """
    if not NAME.fullmatch(name):
        raise FlightError(f"aircraft {name!r}: a name has letters, digits, '_' and '-' only")
    files = [path for path in sorted(folder.rglob("*.xml")) if path.is_file()]
    if len(files) > _MOST_FILES:
        raise FlightError(f"aircraft {name}: more than {_MOST_FILES} files")
    main = folder / f"{name}.xml"
    if main not in files:
        raise FlightError(f"aircraft {name}: {main} is missing")
    for path in files:
        relative = path.relative_to(folder)
        root = read_xml(path, f"aircraft {name}/{relative}")
        strip(root)
        if path == main:
            model = root
        write_xml(root, target / relative)
    if model.tag != "fdm_config":
        raise FlightError(f"aircraft {name}: {main.name} is a <{model.tag}>, not a <fdm_config>")
    return model


@dataclass(frozen=True, slots=True)
class ScriptFacts:
    """Aircraft, length and step that a script specifies."""

    aircraft: str
    length: float  # from its start to its end [s]
    step: float  # that it asks for [s]; infinite if it asks for none
    root: ElementTree.Element


def script_facts(path: Path) -> ScriptFacts:
    """Return the aircraft, the length and the step of a script.

    Raises
    ------
    FlightError
        When it is no script, or names what is no name.
    """
    shown = f"script {path.stem}"
    root = read_xml(path, shown)
    use, run = root.find("use"), root.find("run")
    if root.tag != "runscript" or use is None or run is None:
        raise FlightError(f"{shown}: no <runscript> with <use> and <run>")
    aircraft, initialize = use.get("aircraft", ""), use.get("initialize", "")
    if not NAME.fullmatch(aircraft):
        raise FlightError(f"{shown}: aircraft {aircraft!r} must have letters, digits, '_' and '-' only")
    if initialize and not _FILE.fullmatch(initialize):
        raise FlightError(f"{shown}: initialize {initialize!r} must be the name of a file of the aircraft")
    try:
        length = float(run.get("end", "")) - float(run.get("start", ""))
        step = float(run.get("dt", "inf"))
    except ValueError:
        raise FlightError(f"{shown}: start, end and dt of <run> must be numbers") from None
    if not step > 0:
        raise FlightError(f"{shown}: dt = {step:g} s of <run> must be above 0")
    return ScriptFacts(aircraft, length, step, root)


def class_of(name: str, root: Path) -> str:
    """Return the class of an aircraft of a JSBSim root, by its mass without fuel and its engines.

    Below 150 kg it is "uav", with an afterburner and below 30,000 kg "fighter", above 19,000 lb "transport",
    else "light". A mass that cannot be read counts as none, which is no "uav".

    Raises
    ------
    FlightError
        When its model or an engine is no XML.
    """
    folder, shown = root / "aircraft" / name, f"aircraft {name}"
    model = read_xml(folder / f"{name}.xml", shown)
    try:
        mass = sum(
            float(part.text or "") * _KILOGRAMS[part.get("unit", "LBS").upper()]
            for tag in ("emptywt", "pointmass/weight")
            for part in model.findall(f"mass_balance/{tag}")
        )
    except (KeyError, ValueError):
        mass = 0.0
    if 0.0 < mass < _LIGHTEST:
        return "uav"
    engines = {engine.get("file", "") for engine in model.findall("propulsion/engine")}
    places = (root / "engine", folder / "Engines", folder)
    files = [place / f"{engine}.xml" for engine in engines for place in places]
    found = [read_xml(file, f"{shown}/{file.name}") for file in files if file.is_file()]
    if mass < _AGILE and any((one.findtext("augmented") or "0").strip() == "1" for one in found):
        return "fighter"
    return "transport" if mass > _HEAVIEST else "light"


def copy_script(path: Path, target: Path) -> ScriptFacts:
    """Copy a script without its output and messages, and return its facts."""
    facts = script_facts(path)
    strip(facts.root)
    for parent in list(facts.root.iter()):
        for child in [child for child in parent if _speaks(child)]:
            parent.remove(child)
    write_xml(facts.root, target)
    return facts


def count_engines(model: ElementTree.Element) -> int:
    """Return the number of engines of a model."""
    return sum(len(propulsion.findall("engine")) for propulsion in model.findall("propulsion"))


def system_files(model: Path) -> set[str]:
    """Return the files of the systems a model names."""
    return {system.get("file", "") for system in read_xml(model, model.name).findall("system")}


def rotor_figures(model: Path) -> dict[str, float]:
    """Return positions of rotors and radii of gyration [m], by field of `VibrationSpec`.

    What the model does not declare is left out, and so are the radii of a model with point masses.

    Raises
    ------
    FlightError
        When the model cannot be read.
    """
    root = read_xml(model, model.name)
    set_here = ((one, (one.text or "").strip()) for one in root.iter("property") if one.get("value"))
    found = {_ARMS[name]: _number(one.get("value")) for one, name in set_here if name in _ARMS}
    balance = root.find("mass_balance")
    if balance is not None and balance.find("pointmass") is None:
        mass = _measure(balance.find("emptywt"), _KILOGRAMS, "LBS")
        for axis in "xyz":
            inertia = _measure(balance.find(f"i{axis}{axis}"), _INERTIAS, "SLUG*FT2")
            found[f"gyration_{axis}"] = math.sqrt(max(inertia / mass, 0.0)) if mass else math.nan
    return {name: value for name, value in found.items() if 0.0 < value < math.inf}


def _measure(element: ElementTree.Element | None, units: Mapping[str, float], usual: str) -> float:
    """Return the number of an element in SI; NaN if there is none, or its unit is not known."""
    if element is None:
        return math.nan
    return units.get(element.get("unit", usual), math.nan) * _number(element.text)


def _number(text: str | None) -> float:
    try:
        return float(text or "nan")
    except ValueError:
        return math.nan


def _speaks(element: ElementTree.Element) -> bool:
    """Return whether an element of a script prints, or sets a property of a removed output."""
    sets = element.get("name", "") if element.tag == "set" else (element.text or "")
    return element.tag == "notify" or (
        element.tag in ("set", "property") and sets.strip().startswith("simulation/output")
    )


def strip(root: ElementTree.Element) -> None:
    """Remove elements that write files or open sockets from a model or a script."""
    if root.tag in ("fdm_config", "runscript"):
        for parent in [root, *root.findall("run")]:
            for child in [child for child in parent if child.tag in _UNWANTED]:
                parent.remove(child)


def write_xml(root: ElementTree.Element, path: Path) -> None:
    """Write an XML file and the folders above it."""
    path.parent.mkdir(parents=True, exist_ok=True)
    ElementTree.ElementTree(root).write(path, encoding="utf-8", xml_declaration=True)
