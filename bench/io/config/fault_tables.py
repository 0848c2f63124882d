"""The ``[[fault]]`` tables of a profile: what fails on board, and when."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import reduce
from operator import or_
from typing import TYPE_CHECKING, Annotated, Any, Literal

from pydantic import AfterValidator, Field, TypeAdapter, create_model
from pydantic_core import PydanticCustomError

from bench.core.mathematics.units import to_si
from bench.core.records.fields import figures_of
from bench.core.records.instruments import INSTRUMENTS
from bench.core.records.orbit_sets import LETTERS, SYSTEM_NAMES
from bench.core.records.sensor_specs import Fault, GnssSpec, ImuSpec
from bench.core.words.wording import quantity
from bench.io.config.tables import ROWS, Table, between

_LAST = (32, 24, 36, 63)
"""Number of the last satellite by system: their ICDs."""


def parse_satellite(name: str) -> tuple[int, int]:
    """Return the system code and the number of a satellite from its RINEX name.

    Raises
    ------
    ValueError
        If the name is not that of a satellite.

    Examples
    --------
    >>> parse_satellite("R12")
    (1, 12)
    """
    system = LETTERS.find(name[:1])
    if not (len(name) == 3 and name[1:].isdecimal() and system >= 0 and 1 <= int(name[1:]) <= _LAST[system]):
        known = zip(LETTERS, _LAST, SYSTEM_NAMES, strict=True)
        ranges = ", ".join(f"{letter}01 to {letter}{last} {of}" for letter, last, of in known)
        raise ValueError(f"{name!r} is not a satellite; there are {ranges}")
    return system, int(name[1:])


def _check_satellites(names: tuple[str, ...]) -> tuple[str, ...]:
    for name in names:
        try:
            parse_satellite(name)
        except ValueError as error:
            raise PydanticCustomError("message", "is wrong: {why}", {"why": str(error)}) from None
    if len(set(names)) < len(names):
        raise PydanticCustomError("message", "names a satellite twice")
    return names


Satellites = Annotated[tuple[str, ...], ROWS, AfterValidator(_check_satellites), Field(min_length=1)]
Meters = Annotated[float, between(-1e7, 1e7)]
Speed = Annotated[float, between(-1e4, 1e4)]
Microtesla = Annotated[float, between(-1e4, 1e4)]
Share = Annotated[float, between(0.001, 1)]
Times = Annotated[float, between(0.01, 1e4)]
Axes = Annotated[tuple[Literal["x", "y", "z"], ...], ROWS, Field(min_length=1)]

Timed: Any = Literal[("gnss", *INSTRUMENTS)]
"""Sensors whose records have a time of arrival."""
Counted: Any = Literal[("gnss", *INSTRUMENTS, "imu")]
"""Sensors that output samples."""
Noisy: Any = Literal[("gnss", *INSTRUMENTS, "gyro", "accel")]
"""Sensors with their own noise."""


def _three(number: Any) -> Any:
    return Annotated[tuple[number, number, number], ROWS]


_WORDS = {
    "sensor": "Sensor with the fault.",
    "satellites": "RINEX names, such as G05 and R12.",
    "step_m": "Error from the start on; of a position north, east, down.",
    "step_deg": "Error from the start on.",
    "step_deg_h": "Error from the start on: x, y, z.",
    "step_mg": "Error from the start on: x, y, z.",
    "step_ut": "Field from the start on: x, y, z.",
    "peak_ut": "Field of the magnet at the middle of the fault: north, east, down.",
    "ramp_mps": "Growth of the error; of a position north, east, down.",
    "coherent": "Code and Doppler agree, so that the velocity follows the ramp; else it stays true.",
    "cn0_loss_db": "Loss of C/N0.",
    "axes": "Axes of gyro or accel that freeze. Default: all.",
    "times": "Factor on the white noise of the sensor.",
    "added_s": "Delay in addition to the latency of the sensor.",
    "share": "Share of the samples that are struck, at random.",
}
"""Key of a fault -> what it means."""


class _FaultTable(Table):
    start_s: Annotated[float, between(0, 86400)]
    """Start of the fault."""
    duration_s: Annotated[float, between(0.005, 86400)]
    """Duration."""


def _make_table(kind: str, words: str, **keys: Any) -> type[_FaultTable]:
    """Return the type of the tables of one kind; a key is its type, or its type and its default."""
    rows: dict[str, Any] = {"kind": (Literal[kind], ...)}
    for name, key in keys.items():
        of, default = key if isinstance(key, tuple) else (key, ...)
        rows[name] = (of, Field(default, description=_WORDS[name]))
    return create_model(f"{kind} table", __base__=_FaultTable, __doc__=words, **rows)


_STEPPED = {f"{name}-step": row for name, row in INSTRUMENTS.items() if row.step}
_ZERO = (0.0, 0.0, 0.0)

FAULTS: tuple[type[_FaultTable], ...] = (
    _make_table("satellites-lost", "Named satellites are not received.", satellites=Satellites),
    _make_table(
        "jamming",
        "C/N0 of all satellites is lowered: noise grows, and signals below the threshold are lost.",
        cn0_loss_db=Annotated[float, between(0.1, 60)],
    ),
    _make_table(
        "spoofing",
        "The receiver computes another position.",
        step_m=(_three(Meters), _ZERO),
        ramp_mps=(_three(Speed), _ZERO),
        coherent=(bool, True),
    ),
    _make_table(
        "pseudorange",
        "The pseudoranges of named satellites are off, their Doppler is not.",
        satellites=Satellites,
        step_m=(Meters, 0.0),
        ramp_mps=(Speed, 0.0),
    ),
    _make_table(
        "satellite-clock",
        "The clocks of named satellites drift: pseudoranges and Doppler are off.",
        satellites=Satellites,
        ramp_mps=Speed,
    ),
    _make_table(
        "receiver-clock", "The clock of the receiver steps: all pseudoranges are off.", step_m=Meters
    ),
    *(
        _make_table(kind, f"The output of the {row.title} is off by a step.", **{f"step_{row.step}": Meters})
        for kind, row in _STEPPED.items()
    ),
    _make_table(
        "gyro-step",
        "The biases of the gyros step.",
        step_deg_h=_three(Annotated[float, between(-1e6, 1e6)]),
    ),
    _make_table(
        "accel-step",
        "The biases of the accelerometers step.",
        step_mg=_three(Annotated[float, between(-1e5, 1e5)]),
    ),
    _make_table(
        "mag-step",
        "A magnet or current on board adds a field that is constant in body axes.",
        step_ut=_three(Microtesla),
    ),
    _make_table(
        "magnet-passed",
        "The aircraft passes a magnet on the ground: its field is largest in the middle of the fault.",
        peak_ut=_three(Microtesla),
    ),
    _make_table(
        "frozen",
        "The output keeps its last value while its times go on.",
        sensor=Noisy,
        axes=(Axes | None, None),
    ),
    _make_table("noise-burst", "White noise grows by a factor.", sensor=Noisy, times=Times),
    _make_table(
        "latency", "Measurements arrive later.", sensor=Timed, added_s=Annotated[float, between(0.001, 600)]
    ),
    _make_table("dropped", "Samples are lost at random.", sensor=Counted, share=(Share, 1.0)),
    _make_table("repeated", "Samples are repeated at random.", sensor=Counted, share=(Share, 1.0)),
)
if TYPE_CHECKING:
    FaultTable = Any
else:
    FaultTable = reduce(or_, FAULTS)

_SENSOR = {kind: row.name for kind, row in _STEPPED.items()} | {
    "gyro-step": "gyro",
    "accel-step": "accel",
    "mag-step": "mag",
    "magnet-passed": "mag",
}
"""Kind -> the sensor it affects; other kinds without a key ``sensor`` affect the gnss."""

_NEEDS_SKY = {
    "satellites-lost": "satellites",
    "jamming": "C/N0",
    "pseudorange": "pseudoranges",
    "satellite-clock": "pseudoranges",
    "receiver-clock": "clock",
}
"""Kind for a measurement-level receiver -> what a position-level receiver does not have."""

_STEPS = dict.fromkeys(
    [
        "step_deg_h",
        "step_mg",
        "step_ut",
        "peak_ut",
        "step_m",
        *(f"step_{row.step}" for row in _STEPPED.values()),
    ]
)
"""Keys of a step, in any unit."""


def find_sensor(table: _FaultTable) -> str:
    """Return the sensor that a fault affects."""
    named: str | None = getattr(table, "sensor", None)
    return named or _SENSOR.get(table.kind, "gnss")  # type: ignore[attr-defined]


def read_faults(rows: Sequence[Mapping[str, Any]]) -> tuple[Fault, ...]:
    """Return the faults in SI from the ``fault`` rows of a profile in ``result.json``.

    Raises
    ------
    ValueError
        If a row is not a valid fault.
    """
    adapter = TypeAdapter[Any](Annotated[FaultTable, Field(discriminator="kind")])
    return tuple(make_fault(adapter.validate_python(row)) for row in rows)


def make_fault(table: FaultTable) -> Fault:
    """Return a fault in SI."""
    values = {key: value for key, value in table if value is not None}
    step = next((_to_si(key, values[key]) for key in _STEPS if key in values), ())
    ramp = _to_si("ramp_mps", values["ramp_mps"]) if "ramp_mps" in values else (0.0,) * len(step)
    details = [
        quantity(key, value)
        for key, value in values.items()
        if key not in ("kind", "sensor", "start_s", "duration_s")
        and value != type(table).model_fields[key].default
    ]
    sensor = find_sensor(table)
    return Fault(
        kind=table.kind,
        sensor=sensor,
        start=float(table.start_s),
        end=float(table.start_s + table.duration_s),
        text=f"{table.kind} of {sensor}" + (f": {', '.join(details)}" if details else ""),
        satellites=tuple(parse_satellite(name) for name in values.get("satellites", ())),
        step=step or (0.0,) * len(ramp),
        ramp=ramp,
        loss=float(values.get("cn0_loss_db", 0.0)),
        delay=float(values.get("added_s", 0.0)),
        times=float(values.get("times", 0.0)),
        share=float(values.get("share", 1.0)),
        coherent=bool(values.get("coherent", True)),
        axes=tuple("xyz".index(axis) for axis in values.get("axes", "xyz")),
    )


def _to_si(key: str, value: float | Sequence[float]) -> tuple[float, ...]:
    parts = value if isinstance(value, Sequence) else (value,)
    return tuple(to_si(key, float(part)) for part in parts)


def check_faults(
    tables: Sequence[FaultTable], on_board: Mapping[str, Any], length: float | None
) -> list[str]:
    """Return one line for each fault that is impossible on this aircraft, ends too late, or overlaps another.

    ``on_board`` maps each kind of sensor to its spec or None; ``length`` is the duration of the flight [s],
    None if it is not known before the flight.
    """
    problems = []
    for number, table in enumerate(tables, 1):
        place = f"[[fault]] {number} ({table.kind}): "
        end = table.start_s + table.duration_s
        if length is not None and end > length:
            problems.append(f"{place}its end at {end:g} s is outside the flight, 0 to {length:g} s")
        problems += [f"{place}{line}" for line in _check_fault(table, on_board)]
        for other, earlier in enumerate(tables[: number - 1], 1):
            same = earlier.kind == table.kind and find_sensor(earlier) == find_sensor(table)
            overlap = earlier.start_s < end and table.start_s < earlier.start_s + earlier.duration_s
            if same and overlap and not hasattr(table, "satellites"):
                problems.append(
                    f"{place}{quantity('start_s', table.start_s)} overlaps [[fault]] {other}, the same fault"
                )
    return problems


def _check_fault(table: FaultTable, on_board: Mapping[str, Any]) -> list[str]:
    sensor = find_sensor(table)
    unit = on_board.get("imu" if sensor in ("gyro", "accel") else sensor)
    if unit is None:
        return [f"there is no {sensor} in [sensors]"] if sensor not in ("imu", "gyro", "accel") else []
    steps = [key for key in (*_STEPS, "ramp_mps") if hasattr(table, key)]
    if steps and not any(any(_to_si(key, getattr(table, key))) for key in steps):
        return [f"{' and '.join(steps)}: all are 0; give at least one another value"]
    if table.kind == "frozen" and table.axes is not None and sensor not in ("gyro", "accel"):
        return [f"axes are for sensor = 'gyro' or 'accel'; the {sensor} freezes as a whole"]
    if isinstance(unit, GnssSpec) and table.kind in _NEEDS_SKY and unit.sky is None:
        return [
            f"gnss = {unit.name!r} is a position-level receiver without {_NEEDS_SKY[table.kind]}; "
            "choose one with [sky], such as 'sky-l1'"
        ]
    if table.kind == "noise-burst" and not _has_noise(unit, sensor):
        return [f"{unit.name!r} has no white noise in its {sensor} to multiply"]
    names = getattr(table, "satellites", ())
    if names and isinstance(unit, GnssSpec) and unit.sky is not None:
        from bench.simulation.sensors.measurement_level.view import find_orbits

        numbers = {s: set(find_orbits(unit.sky, s).sat.tolist()) for s in unit.sky.constellations}
        for name in names:
            system, number = parse_satellite(name)
            if number not in numbers.get(system, ()):
                return [f"satellites: {name} is not among the satellites of gnss = {unit.name!r}"]
    return []


def _has_noise(unit: Any, sensor: str) -> bool:
    if isinstance(unit, ImuSpec):
        return bool(getattr(unit, sensor).random_walk > 0)
    if isinstance(unit, GnssSpec) and unit.sky is not None:
        return unit.sky.dll_bandwidth > 0 or unit.sky.fll_bandwidth > 0
    return any(getattr(unit, name) > 0 for name in figures_of(type(unit)) if name.endswith("white_sd"))
