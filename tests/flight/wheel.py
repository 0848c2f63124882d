"""Fly every script and every aircraft of the jsbsim wheel, and print what became of each.

    python -m tests.flight.wheel                     all of them, as a table in Markdown
    python -m tests.flight.wheel c1723 jsbsim:T37    only these

A script is stopped after 60 s. An aircraft flies 10 s straight and a turn of 90 deg at 60 m/s, with gains and
properties of the c172x, whatever it is: the point is that each ends in a flight or in one line.
"""

from __future__ import annotations

import contextlib
import io
import re
import resource
import sys
import tempfile
from pathlib import Path
from typing import NamedTuple

from bench.cli.command_line import main
from bench.core.words.exceptions import FlightError
from bench.io.config.external_truth import find_jsbsim_root, list_root_aircraft
from bench.simulation.flight.model_files import script_facts

LONGEST = 60.0
"""A script is stopped then [s]."""
SHEET = Path(__file__).parents[2] / "aircraft" / "jsbsim" / "c172x.toml"
PLAN = """aircraft = "{name}"
start = {{ lat_deg = 47.0, lon_deg = 11.0, alt_m = 1200.0, heading_deg = 85.0, speed_mps = 60.0 }}
leg = [{{ kind = "straight", duration_s = 10.0 }}, {{ kind = "turn", by_deg = 90.0, bank_deg = 20.0 }}]
sensors = {{ imu = "adis16475" }}
estimator = [{{ use = "free-inertial" }}]
"""


class Outcome(NamedTuple):
    """What became of a script or an aircraft."""

    name: str
    status: int
    text: str  # why it does not fly, or that it flew and whether its sanity report has remarks
    cpu: float  # [s]


def fly(name: str) -> Outcome:
    """Fly a script, or an aircraft ``jsbsim:NAME``, by ``bench fly`` in an empty folder."""
    before, output, errors = _cpu(), io.StringIO(), io.StringIO()
    with tempfile.TemporaryDirectory() as folder, contextlib.chdir(folder):
        Path("profile.toml").write_text(_write_profile(name))
        with contextlib.redirect_stdout(output), contextlib.redirect_stderr(errors):
            status = main(["fly", "profile.toml"])
    if status == 0:
        text = "flown, with remarks" if "anity" in output.getvalue() else "flown"
    else:
        text = errors.getvalue().strip()
    return Outcome(name, status, text, _cpu() - before)


def _write_profile(name: str) -> str:
    if name.startswith("jsbsim:"):
        sheet = Path("aircraft/jsbsim") / f"{name.removeprefix('jsbsim:')}.toml"
        sheet.parent.mkdir(parents=True)
        text = SHEET.read_text()
        if "piston" not in _read_engines(sheet.stem):
            text = re.sub(r"\[properties\].*?\n\n", "", text, flags=re.S)  # of a piston engine
        sheet.write_text(text)
        return PLAN.format(name=name)
    with contextlib.suppress(FlightError):
        facts = script_facts(find_jsbsim_root(None, Path()) / "scripts" / f"{name}.xml")
        if facts.length > LONGEST:
            return f'script = "{name}"\nduration_s = {LONGEST}\nevaluation = {{ from_s = 0.0 }}\n'
    return f'script = "{name}"\n'


def _read_engines(aircraft: str) -> str:
    """Return the files of the engines of an aircraft of the wheel."""
    root = find_jsbsim_root(None, Path())
    names = re.findall(
        r'<engine[^>]*file="([^"]*)"', (root / f"aircraft/{aircraft}/{aircraft}.xml").read_text()
    )
    files = [root / f"engine/{name}.xml" for name in names]
    return "".join(file.read_text() for file in files if file.is_file())


def _cpu() -> float:
    return sum(
        used.ru_utime + used.ru_stime
        for used in map(resource.getrusage, (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN))
    )


def list_names() -> list[str]:
    """Return every script and aircraft of the wheel."""
    root = find_jsbsim_root(None, Path())
    scripts = sorted(path.stem for path in root.glob("scripts/*.xml"))
    return [*scripts, *(f"jsbsim:{name}" for name in list_root_aircraft(root))]


if __name__ == "__main__":
    print("| name | status | outcome | CPU [s] |\n|---|---|---|---|")
    for name in sys.argv[1:] or list_names():
        found = fly(name)
        print(f"| `{name}` | {found.status} | {found.text} | {found.cpu:.0f} |", flush=True)
