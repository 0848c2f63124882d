"""Motion definitions of gnss-ins-sim: an initial state, and commands that are flown by its rules.

The rules are those of ``path_gen`` in gnss_ins_sim/pathgen/pathgen.py of github.com/Aceinna/gnss-ins-sim, at
the 100 Hz of its demos and with its own limits. Angles are yaw, pitch, roll in degrees; velocities are in b.
Command 1 sets their rates, which a filter of the first order follows. Commands 2 to 5 set what they become:
attitude and velocity absolute (2), both as changes (3), the velocity as a change (4), the attitude as a
change (5). They end early if attitude and velocity are reached.
"""

from __future__ import annotations

import csv
import math
from collections.abc import Iterator, Sequence
from itertools import islice
from pathlib import Path

import numpy as np
from scipy.integrate import cumulative_trapezoid

from bench.core.files.file_checks import check_file
from bench.core.mathematics.arrays import FloatArray
from bench.core.mathematics.earth import matrix_en, radii, to_ecef
from bench.core.mathematics.rotation import continuous, from_euler, from_matrix, multiply, rotate
from bench.core.words.exceptions import ConfigError
from bench.io.trajectories.track_motion import TableMotion

_MARK = "ini lat"
"""How the first line begins."""
_RATE = 100.0  # of the steps of its rules [Hz]
_FORCE, _TURN_UP, _TURN = (
    1.0,
    0.5,
    2.0,
)  # largest change of a velocity, of a rate, and rate [m/s^2], [rad/s^2], [rad/s]
_KEPT = 0.9  # of a filtered command from one step to the next [1]
_STIFF, _DAMPED = 5.0, 10.0  # gains of the attitude [1/s^2], [1/s]
_REACHED = 1e-4  # norm of what is missing [rad], [m/s]
_MOST_BYTES, _LONGEST = 1_000_000, 7200.0  # of a file; of all commands [s]
_LIMITS = (90.0, 360.0, 1e5, *[1e3] * 3, *[1e4] * 3)  # of the initial state
_COMMAND = (1e3, *[1e5] * 3, *[1e3] * 3, _LONGEST)  # limits of a command
_PICARD = 5  # iterations of the positions; each leaves the part of the path in the radius of the Earth


def is_motion_definition(path: Path) -> bool:
    """Return whether a file is a motion definition, by its first line."""
    try:
        with path.open("rb") as file:
            return file.read(len(_MARK) + 3).decode("utf-8-sig", "replace").lstrip('"').startswith(_MARK)
    except OSError:
        return False


def fly_commands(path: Path) -> TableMotion:
    """Return the motion that a motion definition commands, 100 rows per second.

    Raises
    ------
    ConfigError
        If the file is broken or commands more than two hours: one line names the row.
    """
    state, commands = _read_commands(path)
    rows = np.array(list(_follow(state[3:], commands)))
    if len(rows) < 2:
        raise ConfigError(f"{path.name}: the durations of its commands are 0 s")
    t, q_nb = np.arange(len(rows)) / _RATE, from_euler(rows[:, 2], rows[:, 1], rows[:, 0])
    vel_n = rotate(q_nb, rows[:, 3:])
    start = np.array([math.radians(state[0]), math.radians(state[1]), state[2]])
    lla = np.tile(start, (len(t), 1))
    for _ in range(_PICARD):
        meridian, prime = radii(lla[:, 0])
        moved = np.column_stack(
            [meridian + lla[:, 2], (prime + lla[:, 2]) * np.cos(lla[:, 0]), -np.ones(len(t))]
        )
        lla = start + cumulative_trapezoid(vel_n / moved, t, axis=0, initial=0.0)
    if not (np.abs(lla[:, 0]) < math.radians(89.0)).all():
        raise ConfigError(f"{path.name}: its commands lead to within 1 deg of a pole")
    q_en = from_matrix(matrix_en(lla[:, 0], lla[:, 1]))
    note = f"{len(commands)} commands of gnss-ins-sim, at most {_FORCE:g} m/s^2 and {_TURN:g} rad/s"
    seen = {command[8:9] for command in commands}
    notes = [note, "GPS visibility is not used: use [[gnss_outage]]"] if len(seen) > 1 else [note]
    q_eb = continuous(multiply(q_en, q_nb))
    return TableMotion(
        t, to_ecef(lla), q_eb, rotate(q_en, vel_n), [(0.0, 0.0, "table", one) for one in notes]
    )


def _read_commands(path: Path) -> tuple[list[float], list[tuple[float, ...]]]:
    """Return the initial state (9) as in the file, and the commands: type, angles, velocities, duration."""
    shown = path.name
    try:
        check_file(path, shown, _MOST_BYTES)
        with path.open(encoding="utf-8-sig", newline="") as file:
            lines = [
                (k, row) for k, row in enumerate(csv.reader(file), 1) if any(cell.strip() for cell in row)
            ]
    except (OSError, UnicodeDecodeError, csv.Error) as error:
        raise ConfigError(f"{shown}: cannot be read: {' '.join(str(error).split())[:200]}") from None
    if len(lines) < 4:
        raise ConfigError(
            f"{shown}: {len(lines)} lines; expected names, the initial state, names, and commands"
        )
    state = _read_numbers(lines[1], _LIMITS, shown)
    commands = [tuple(_read_numbers(line, _COMMAND, shown)) for line in lines[3:]]
    for (k, _), command in zip(lines[3:], commands, strict=True):
        if command[0] not in (1.0, 2.0, 3.0, 4.0, 5.0) or command[7] < 0.0:
            raise ConfigError(f"{shown}: line {k}: expected a command type from 1 to 5 and a duration [s]")
    if (length := sum(command[7] for command in commands)) > _LONGEST:
        raise ConfigError(f"{shown}: its commands last {length:.6g} s, more than {_LONGEST:g} s")
    return state, commands


def _read_numbers(line: tuple[int, list[str]], limits: Sequence[float], shown: str) -> list[float]:
    number, cells = line
    try:
        values = [float(cell or 0.0) for cell in islice(cells, 9)]
    except ValueError:
        raise ConfigError(f"{shown}: line {number}: not a row of numbers") from None
    if len(values) < len(limits):
        raise ConfigError(f"{shown}: line {number}: {len(values)} values; expected {len(limits)}")
    for k, (value, most) in enumerate(zip(values, limits, strict=False), 1):
        if not abs(value) <= most:
            raise ConfigError(f"{shown}: line {number}: value {k} is {value:g}; expected at most {most:g}")
    return values


def _follow(state: Sequence[float], commands: Sequence[tuple[float, ...]]) -> Iterator[FloatArray]:
    """Yield attitude (yaw, pitch, roll) and velocity in b (6,) of each step."""
    vel, att = np.array(state[:3]), np.radians(state[3:])
    turning, speeding = np.zeros(3), np.zeros(3)
    yield np.concatenate([att, vel])
    for kind, *numbers in commands:
        angles, speeds = np.radians(numbers[:3]), np.array(numbers[3:6])
        wanted_att = att + angles if kind in (3.0, 5.0) else angles
        wanted_vel = vel + speeds if kind in (3.0, 4.0) else speeds
        soft = vel
        for _ in range(round(numbers[6] * _RATE)):
            reached = False
            if kind == 1.0:
                turning = _KEPT * turning + (1.0 - _KEPT) * angles
                speeding = _KEPT * speeding + (1.0 - _KEPT) * speeds
            else:
                soft = _KEPT * soft + (1.0 - _KEPT) * wanted_vel
                speeding = ((soft - vel) * _RATE).clip(-_FORCE, _FORCE)
                pull = (_STIFF * (wanted_att - att) - _DAMPED * turning).clip(-_TURN_UP, _TURN_UP)
                turning = (turning + pull / _RATE).clip(-_TURN, _TURN)
                missing = max(math.dist(att, wanted_att), math.dist(vel, wanted_vel))
                reached = missing < _REACHED
            vel, att = vel + speeding / _RATE, att + turning / _RATE
            yield np.concatenate([att, vel])
            if reached:
                turning, speeding = np.zeros(3), np.zeros(3)
                break
