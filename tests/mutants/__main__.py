"""Errors made on purpose, and those that no test detects: ``make mutants PACKAGE=studies SEED=1 COUNT=30``.

A sample is drawn of the errors that a package allows. Each is made in a copy of the tree and run against the
tests that execute its line, until one fails. What no test detects is printed: write a test, or say in
``equivalent.toml`` why the program is the same. The first run finds out which tests execute which line, which
takes longer than the tests themselves; it is kept until the tree changes. ``TESTS=tests/studies`` runs only
these: that is quick, and misses what other tests detect. Two packages may be examined side by side.

No library fits: mutmut and cosmic-ray find no test for a line of a kernel, which coverage cannot see.
"""

from __future__ import annotations

import argparse
import contextlib
import hashlib
import json
import shutil
import sys
import time
import tomllib
from collections import Counter
from collections.abc import Iterator, Sequence
from itertools import accumulate
from pathlib import Path

from bench.core.files.places import PACKAGE, cache_folder
from bench.core.files.scratch import make_scratch
from bench.core.words.exceptions import BenchError
from tests.mutants.executed import Executed, find_file, measure
from tests.mutants.plugin import CHOSEN
from tests.mutants.sites import Mutant, draw, find_mutants
from tests.mutants.trial import Trial

EQUIVALENT = Path("tests") / "mutants" / "equivalent.toml"
"""Errors that change nothing, each with its reason."""

_MOST_SECONDS = 300.0  # of tests for one error; those of the quickest files are taken first
_PATIENCE = 180.0, 5.0  # for one error [s], and per second that its tests took: then it counts as detected
_NOTHING_FAILED = (0, 5)  # exit status of pytest: all passed; there was nothing to run


def read_equivalent(root: Path) -> set[tuple[str, str, str, str]]:
    """Return the keys of the mutants that are marked as equivalent; each entry must be one of the tree."""
    path = root / EQUIVALENT
    entries = tomllib.loads(path.read_text(encoding="utf-8"))["equivalent"] if path.exists() else []
    marked = set()
    for entry in entries:
        key = (entry["file"], entry["where"], entry["before"], entry["after"])
        source = root / entry["file"]
        if not source.exists() or key not in {one.key for one in find_mutants(source, root)}:
            raise BenchError(f"{path}: in {key[0]} {key[1]} no mutant turns {key[2]!r} into {key[3]!r}")
        if not entry["reason"].strip():
            raise BenchError(f"{path}: in {key[0]} {key[1]} the reason is empty")
        marked.add(key)
    return marked


def find_sources(root: Path, package: str) -> list[Path]:
    """Return the sources of a package or module of bench."""
    folder = root / "bench" / package.removesuffix(".py")
    found = sorted(folder.rglob("*.py")) if package else []
    found = found or [one for one in [folder.with_suffix(".py")] if package and one.is_file()]
    if not found:
        known = ", ".join(sorted(one.parent.name for one in (root / "bench").glob("*/__init__.py")))
        raise BenchError(f"PACKAGE={package}: name a package or module of bench, as {known}")
    return found


def collect(trial: Trial, tests: Sequence[str]) -> Executed:
    """Return which lines tests execute, as measured now or earlier in the same folders."""
    digest = hashlib.sha256("\n".join(tests).encode())
    for path in sorted(trial.root.glob("*/**/*")):
        if path.is_file() and path != trial.root / EQUIVALENT:
            digest.update(f"{path.relative_to(trial.root)}\0".encode() + path.read_bytes())
    kept = cache_folder("mutants") / digest.hexdigest()[:24]
    if not kept.exists():
        print("Finding out which tests execute which line.", flush=True)
        new = trial.scratch / "found"
        new.mkdir()
        measure(trial, tests, new)
        for old in set(kept.parent.glob("[0-9a-f]*")) - {kept}:
            shutil.rmtree(old, ignore_errors=True)
        with contextlib.suppress(OSError):  # another run was faster
            new.rename(kept)
    executed = Executed(trial.root, kept)
    if executed.left_out:
        print(f"{executed.left_out} tests did not pass or were skipped in the unchanged copy: left out.")
    return executed


def try_mutant(trial: Trial, executed: Executed, mutant: Mutant) -> tuple[str, str]:
    """Return "detected", "undetected" or "out of time", and how many tests were run: quick files first."""
    seconds = {one: executed.seconds[one] for one in executed.find_tests(mutant.file, mutant.place)}
    if not seconds:
        return "unnoticed", "no test executes it"
    of_file = {find_file(one): 0.0 for one in seconds}
    for one in seconds:
        of_file[find_file(one)] += seconds[one]
    order = sorted(seconds, key=lambda one: (of_file[find_file(one)], find_file(one), seconds[one], one))
    until = accumulate(seconds[one] for one in order)
    chosen = [one for one, total in zip(order, until, strict=True) if total < _MOST_SECONDS] or order[:1]
    listed = trial.scratch / "chosen.json"
    listed.write_text(json.dumps(chosen), "utf-8")
    limit = _PATIENCE[0] + _PATIENCE[1] * sum(seconds[one] for one in chosen)
    source, begun = (trial.root / mutant.file).read_bytes(), time.monotonic()
    trial.write(mutant.file, mutant.apply(source))
    files = dict.fromkeys(map(find_file, chosen))
    status, _ = trial.run_tests("--exitfirst", *files, variables={CHOSEN: listed}, limit=limit)
    trial.write(mutant.file, source)
    result = "out of time" if status is None else "unnoticed" if status in _NOTHING_FAILED else "noticed"
    return result, f"{len(chosen)} of {len(order)} tests, {time.monotonic() - begun:.0f} s"


def examine(root: Path, package: str, seed: int, count: int, tests: Sequence[str]) -> Iterator[str]:
    """Yield what is to be printed: each mutant, with its source if no test detects it, and the sum."""
    mutants = [one for path in find_sources(root, package) for one in find_mutants(path, root)]
    marked = read_equivalent(root)
    drawn = draw([one for one in mutants if one.key not in marked], count, seed)
    place = cache_folder("mutants")
    place.mkdir(parents=True, exist_ok=True)
    results: Counter[str] = Counter()
    with make_scratch(place) as scratch:  # also for compiled kernels
        trial = Trial(root, scratch)
        executed = collect(trial, tests)
        for one in drawn:
            result, told = try_mutant(trial, executed, one)
            results[result] += 1
            yield f"{result}: {one.file}:{one.line} {one.place.where}".rstrip() + f" ({one.kind}; {told})"
            if result == "unnoticed":
                yield from (f"  - {line}" for line in one.before.splitlines())
                yield from (f"  + {line}" for line in one.after.splitlines())
    noticed, marks = len(drawn) - results["unnoticed"], sum(one.key in marked for one in mutants)
    yield (
        f"{noticed} of {len(drawn)} detected, {results['out of time']} of them by taking too long; "
        f"drawn from {len(mutants) - marks} with seed {seed}, {marks} marked as equivalent left out"
    )


def main(arguments: Sequence[str] | None = None) -> int:
    """Print what `examine` finds."""
    parser = argparse.ArgumentParser(prog="python -m tests.mutants", description=__doc__.partition("\n\n")[0])
    parser.add_argument("package", help="package or module of bench, as studies or navigation/models")
    parser.add_argument("--seed", type=int, required=True, help="of the run")
    parser.add_argument("--count", type=int, default=30, help="of mutants")
    parser.add_argument(
        "--tests", nargs="*", default=[], help="files or folders of tests; all if none is named"
    )
    given = parser.parse_args(arguments)
    try:
        for line in examine(PACKAGE.parent, given.package, given.seed, given.count, given.tests):
            print(line, flush=True)
    except BenchError as error:
        print(*(f"error: {line}" for line in error.lines), sep="\n", file=sys.stderr)
        return error.status
    except KeyboardInterrupt:
        return 130
    return 0


if __name__ == "__main__":
    sys.exit(main())
