"""The verb new: write a working example into the present folder."""

from __future__ import annotations

import contextlib
import keyword
import re
from importlib.util import find_spec
from pathlib import Path

from rich.console import Console

from bench.errors import ConfigError

_CLASS = "StartingPoint"

_TEST = '''"""Test of {cls} with `pytest test_{name}.py`: the contract of the bench, and its accuracy."""

import bench
from {name} import {cls}


def test_contract_and_accuracy():
    truth = bench.fly("figure-eight")
    sensed = bench.sense("figure-eight", truth)
    bench.check_estimator({cls}(), sensed.data, sensed.initial)
    solution = {cls}().run(sensed.data, sensed.initial)
    _, metrics = bench.judge("figure-eight", truth, solution)
    assert metrics["converged"], metrics["reason"]
    assert metrics["pos_rmse_h_m"] < 30.0
'''


def new_estimator(name: str, *, console: Console) -> None:
    """Write ``NAME.py`` with an estimator and ``test_NAME.py`` with its test.

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
    written: list[Path] = []
    try:
        for path, text in texts.items():
            with path.open("x", encoding="utf-8") as file:
                written.append(path)
                file.write(text)
    except BaseException:
        for path in written:
            with contextlib.suppress(OSError):
                path.unlink()
        raise
    console.print(f"Wrote {' and '.join(str(path) for path in texts)}.")
    console.print(f"Next: bench run figure-eight -e {name}:{cls}")
