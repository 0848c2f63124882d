"""The built-in filters by name, and how a filter is built from a name and its options.

Filter and options of a row are imported when they are asked for: listing the names loads neither numba nor
pydantic.
"""

from __future__ import annotations

import importlib
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

from bench.core.files.installed import find_class, find_own, read_constant
from bench.core.words.exceptions import EstimatorError
from bench.core.words.wording import as_toml
from bench.navigation.estimator import Estimator, catch_exit, construct
from bench.navigation.forward_filters import FORWARD

if TYPE_CHECKING:
    from bench.navigation.options import Options


@dataclass(frozen=True, slots=True)
class BuiltIn:
    """A built-in estimator."""

    title: str
    place: str  # "module:Class"
    model: str  # "Class" of its options, in `bench.navigation.options`, or "module:Class"
    fixed: Mapping[str, Any] = field(default_factory=dict)  # options that make it what it is
    package: str | None = None  # that has to be installed beside bench

    def import_class(self) -> type[Estimator]:
        """Return the class of the filter."""
        module, _, name = self.place.partition(":")
        found: type[Estimator] = getattr(importlib.import_module(module), name)
        return found

    @property
    def options(self) -> type[Options]:
        """Class of the options of the filter."""
        module, _, name = self.model.rpartition(":")
        found: type[Options] = getattr(importlib.import_module(module or "bench.navigation.options"), name)
        return found

    def wrong(self, given: Mapping[str, Any]) -> list[str]:
        """Return a line for each option of a profile that is wrong."""
        clash = sorted(set(self.fixed) & set(given))
        return [
            *(f"option {name!r} is fixed to {as_toml(self.fixed[name])}; leave it out" for name in clash),
            *self.options.list_wrong({k: v for k, v in given.items() if k not in clash}, self.fixed),
        ]


_LOOSE = "bench.navigation.models.loose_tight:Loose"

_CORE = {
    "loose-15": BuiltIn(
        "INS/GNSS/baro, 15 states and a baro bias", _LOOSE, "FusionOptions", FORWARD["loose-15"]
    ),
    "loose-22": BuiltIn(
        "loose-15 with GNSS Markov errors, 22 states", _LOOSE, "FusionOptions", FORWARD["loose-22"]
    ),
    "loose-mems": BuiltIn(
        "loose-22 with scale factors and g-sensitivity, 37 states",
        _LOOSE,
        "FusionOptions",
        FORWARD["loose-mems"],
    ),
    "loose-full": BuiltIn(
        "loose-22 with a state or noise for every error of the IMU that its datasheet names",
        _LOOSE,
        "FusionOptions",
        FORWARD["loose-full"],
    ),
    "tight": BuiltIn(
        "loose-full with ranges and rates and states for their correlated errors; works with one satellite",
        "bench.navigation.models.loose_tight:Tight",
        "TightOptions",
        FORWARD["tight"],
    ),
    "smoother": BuiltIn(
        "loose-full with a backward pass over the record",
        "bench.navigation.models.smoother:Smoother",
        "SmootherOptions",
        {"gnss": True},
    ),
    "baro-inertial": BuiltIn(
        "IMU and barometer", _LOOSE, "FusionOptions", {"gnss": False, "gnss_markov": False}
    ),
    "free-inertial": BuiltIn(
        "IMU alone, with its open-loop covariance",
        _LOOSE,
        "FusionOptions",
        {"gnss": False, "baro": False, "gnss_markov": False},
    ),
    "gnss-only": BuiltIn(
        "position and velocity from the fixes, without IMU",
        "bench.navigation.models.gnss_only:GnssOnly",
        "GnssOnlyOptions",
    ),
    "ukf": BuiltIn(
        "the states of loose-15 by sigma points, slow",
        "bench.navigation.models.ukf:Unscented",
        "UnscentedOptions",
    ),
    "classic-22": BuiltIn(
        "the published filter of 22 states step by step, slow: the reference of loose-22",
        "bench.navigation.models.classic:Classic22",
        "ClassicOptions",
    ),
    "invariant-ekf": BuiltIn(
        "loose-15 as an invariant EKF on SE2(3): errors in body axes; fixes only; slow",
        "bench.navigation.models.invariant_ekf:InvariantEkf",
        "InvariantOptions",
    ),
    "ahrs": BuiltIn(
        "attitude and gyro bias from IMU and magnetometer, without position",
        "bench.navigation.models.ahrs:Ahrs",
        "AhrsOptions",
    ),
}


def _add_plugins() -> Iterator[tuple[str, BuiltIn]]:
    for name, place in find_own("estimators").items():
        rows = read_constant(place.partition(":")[0], "ESTIMATORS")
        yield name, BuiltIn(place=place, **rows[name])


BUILT_IN: Mapping[str, BuiltIn] = {**_CORE, **dict(_add_plugins())}
"""Name of a filter of bench, of a plug-in last -> what it is."""


def load(use: str, options: Mapping[str, Any]) -> Estimator:
    """Build a filter from a built-in name or ``module:Class`` and the keywords of its constructor.

    Raises
    ------
    EstimatorError
        If there is no such filter or an option is wrong, one message each. An error inside a user's
        module on import keeps its traceback.
    """
    if use in BUILT_IN:
        row = BUILT_IN[use]
        if wrong := row.wrong(options):
            raise EstimatorError(*(f"filter {use!r}: {line}" for line in wrong))
        return construct(use, row.import_class(), {**row.fixed, **options})
    if not is_class(use):
        raise EstimatorError(f"no filter {use!r}; there are {', '.join(BUILT_IN)}, or 'module:Class'")
    return construct(use, _import_class(use, find_class(use, BUILT_IN)), options)


def _import_class(use: str, place: str) -> Any:
    """Return the class "module:Class" of another package."""
    module_name, _, class_name = place.partition(":")
    try:
        with catch_exit(use, "its module"):
            module = importlib.import_module(module_name)
    except ModuleNotFoundError as error:
        if not f"{module_name}.".startswith(f"{error.name}."):
            raise
        raise EstimatorError(f"filter {use!r}: no module {error.name!r} on the Python path") from None
    found = getattr(module, class_name, None)
    if not callable(getattr(found, "run", None)):
        raise EstimatorError(f"filter {use!r}: {module_name} has no class {class_name!r} with a method run")
    return found


def is_class(use: str) -> bool:
    """Return whether a filter is a class that is not built in: ``module:Class`` or an installed one."""
    use = find_class(use, BUILT_IN)
    return ":" in use and all(part.isidentifier() for part in use.replace(":", ".", 1).split("."))


def takes_option(use: str, name: str) -> bool:
    """Return whether a built-in filter has an option that a profile may set."""
    return use in BUILT_IN and name in BUILT_IN[use].options.model_fields and name not in BUILT_IN[use].fixed


def takes_offset(use: str, built: Estimator) -> bool:
    """Return whether a built-in filter, as ``built``, can estimate the clock offset of fixes."""
    options: Any = getattr(built, "options", None)
    return takes_option(use, "time_offset_sd") and options.gnss and not options.tight
