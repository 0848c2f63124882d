"""The verb new: write a working example into the present folder."""

from __future__ import annotations

import contextlib
import json
import keyword
import re
from collections.abc import Callable, Mapping
from importlib.util import find_spec
from pathlib import Path

from rich.console import Console

from bench.cli.verbs import check_verb
from bench.core.files import durable
from bench.core.words.exceptions import ConfigError
from bench.core.words.wording import one_line
from bench.experiments.baselines.checking import DIRECTORY
from bench.experiments.baselines.pinning import find_requirement
from bench.experiments.campaigns.campaign_file import CampaignTable
from bench.io.config.checks import is_code
from bench.io.config.schemas import DIALECT, SCHEMAS, make_schema

_CLASS = "StartingPoint"

_TEST = '''"""Test of {cls} with `pytest test_{name}.py`: the contract of the bench, and its accuracy."""

import bench
from {name} import {cls}


def test_contract_and_accuracy():
    truth = bench.fly("figure-eight")
    sensed = bench.sense("figure-eight", truth)
    bench.check_estimator({cls}(), sensed.data, sensed.initial)
    solution = {cls}().run(sensed.data, sensed.initial)
    _, metrics = bench.evaluate("figure-eight", truth, solution)
    assert metrics["converged"], metrics["reason"]
    assert metrics["pos_rmse_h_m"] < 30.0
'''


_PROFILE = """\
# A turn, a straight leg, GNSS lost for 20 s: short enough for every push.
title    = "Two minutes"
aircraft = "aerosonde"
rate_hz  = 100
seed     = 1
duration_s = 120.0

[start]
lat_deg = 47.0
lon_deg = 11.0
alt_m   = 1000.0
heading_deg = 10.0
speed_mps   = 25.0

[[leg]]
kind = "turn"
by_deg = 360.0
bank_deg = 25.0

[[leg]]
kind = "straight"
duration_s = 60.0

[sensors]
imu  = "adis16475"
gnss = "l1-code"
baro = "bmp388"

[[gnss_outage]]
start_s = 80.0
duration_s = 20.0

[evaluation]
from_s = 20.0

[[estimator]]
use = "{use}"
"""

_WORKFLOW = """\
# Fails if a change makes the filter worse than tests/baselines says.
name: accuracy
on: [push, pull_request]
jobs:
  check:
    runs-on: ubuntu-latest
    steps:
      - uses: actions/checkout@v4
      - uses: actions/setup-python@v5
        with:
          python-version: "3.12"
      - run: pip install "{requirement}"{remark}
      - run: bench check --junit accuracy.xml{option}
      - uses: actions/upload-artifact@v4
        if: always()
        with:
          name: accuracy
          path: accuracy.xml
"""


def new_check(use: str, *, console: Console, draws: int = 40) -> None:
    """Write a short profile, record its baseline with a filter, and write a CI workflow.

    Parameters
    ----------
    use : str
        The estimator: a built-in name or ``module:Class``.
    draws : int
        Number of runs of the baseline.

    Raises
    ------
    bench.BenchError
        If a file is there already, or the filter cannot be built; nothing is left behind then.
    """
    profile, workflow = DIRECTORY / "short.toml", Path(".github/workflows/accuracy.yml")
    if not re.fullmatch(r"[A-Za-z0-9_.:-]+", use):
        raise ConfigError(f"{use!r}: must be a built-in filter or module:Class")
    option = " --allow-code" if is_code(use) else ""
    requirement, remark = find_requirement()
    steps = _WORKFLOW.format(
        option=option, requirement=requirement, remark=f"  # {one_line(remark)}" if remark else ""
    )
    texts = {profile: _PROFILE.format(use=use), workflow: steps}
    for path in (*texts, profile.with_suffix(".json")):
        if path.exists() or path.is_symlink():
            raise ConfigError(
                f"{path}: exists already and is not replaced; 'bench check {profile} -e {use} --record' "
                "records a filter on it"
            )
    for path in texts:
        path.parent.mkdir(parents=True, exist_ok=True)
    _write_all(texts, lambda: check_verb.record([str(profile)], console=console, runs=draws, allow_code=True))
    console.print(f"Wrote {profile} and {workflow}. Keep them in your repository.")
    console.print(f"{workflow} installs {requirement}" + (f": {remark}" if remark else ""), soft_wrap=True)
    console.print(f"Next: bench check{option}")


def new_estimator(name: str, *, console: Console) -> None:
    """Write ``NAME.py`` with a filter and ``test_NAME.py`` with its test.

    Parameters
    ----------
    name : str
        Name of the module: lower-case letters, digits and underscores. The class has this name in CamelCase.

    Raises
    ------
    ConfigError
        If the name is no name for a module, stands for another one, or a file is there already; nothing
        is written then.
    """
    cls = "".join(part.capitalize() for part in name.split("_"))
    if not re.fullmatch(r"[a-z][a-z0-9_]{0,63}", name) or keyword.iskeyword(name) or keyword.iskeyword(cls):
        raise ConfigError(
            f"{name!r} cannot name a module: use lower-case letters, digits and underscores, "
            "a letter first, no keyword"
        )
    source = Path(__file__).with_name("starting_point.py").read_text(encoding="utf-8")
    texts = {
        Path(f"{name}.py"): re.sub(rf"\b{_CLASS}\b", cls, source),
        Path(f"test_{name}.py"): _TEST.format(name=name, cls=cls),
    }
    for path in (*texts, Path(name)):
        if path.exists() or path.is_symlink():
            raise ConfigError(f"{path}: exists already and is not replaced; choose another name")
    if find_spec(name) is not None or re.search(rf"\b{cls}\b", source):
        raise ConfigError(f"{name!r}: the name is used already; choose another one")
    _write_all(texts)
    console.print(f"Wrote {' and '.join(str(path) for path in texts)}.")
    console.print(f"Next: bench run figure-eight -e {name}:{cls}")


def new_schemas(*, console: Console) -> None:
    """Write the JSON schema of each kind of TOML file into the folder ``schemas``.

    Schemas of an older bench are replaced; a file that is none is rejected.

    Raises
    ------
    ConfigError
        If a file of another kind is there.
    """
    made = {kind: make() for kind, make in SCHEMAS.items()}
    made["campaign"] = make_schema(CampaignTable, "A campaign of bench")
    texts = {
        Path("schemas") / f"{kind}.json": json.dumps(schema, indent=1) + "\n" for kind, schema in made.items()
    }
    for path in texts:
        if path.exists() and DIALECT not in path.read_text(encoding="utf-8", errors="replace"):
            raise ConfigError(f"{path}: exists and is not a schema; it is not replaced")
    Path("schemas").mkdir(exist_ok=True)
    for path, text in texts.items():
        durable.write(path, text)
    console.print(f"Wrote schemas/ with {', '.join(sorted(made))}.")
    console.print(
        "Next: the first line of a profile, for an editor that knows TOML: #:schema ./schemas/profile.json"
    )


def _write_all(texts: Mapping[Path, str], finish: Callable[[], object] = lambda: None) -> None:
    """Write new files and run a step that needs them; if anything fails, remove all files."""
    written: list[Path] = []
    try:
        for path, text in texts.items():
            durable.write(path, text)
            written.append(path)
        finish()
    except BaseException:
        for path in written:
            with contextlib.suppress(OSError):
                path.unlink()
        raise
