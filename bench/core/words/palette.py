"""Colors of all pages, recordings and figures, on light and on dark ground: seven, and a color for fixes.

Any two are at least 20 apart by CIEDE2000, with normal sight and without red, green or blue cones, and stand
out from the ground by 3:1 (`tests/test_palette.py` computes both). They were found by simulated annealing.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import NamedTuple

Color = tuple[int, int, int]


class PaletteSlot(NamedTuple):
    """A color in both tones."""

    name: str
    dark: Color  # on dark ground, as in the viewer
    light: Color  # on light ground, as on paper


SLOTS = (
    PaletteSlot("green", (48, 154, 1), (49, 161, 126)),
    PaletteSlot("blue", (167, 164, 252), (70, 0, 255)),
    PaletteSlot("red", (225, 136, 158), (128, 1, 1)),
    PaletteSlot("violet", (133, 50, 255), (70, 51, 96)),
    PaletteSlot("teal", (173, 251, 255), (16, 104, 84)),
    PaletteSlot("pink", (163, 77, 112), (153, 136, 179)),
    PaletteSlot("yellow", (237, 222, 26), (183, 107, 19)),
)
"""The first is the truth; the others are estimators."""

FIXES = PaletteSlot("fixes", (244, 255, 213), (48, 0, 16))
"""Fixes of a receiver, always dots."""

_TONES = (*SLOTS, FIXES)

_OWNERS: Mapping[str, int] = {
    **dict.fromkeys(("loose-full", "loose-mems", "error-ekf"), 1),
    **dict.fromkeys(("loose-15", "fixed-gain", "least-squares"), 2),
    **dict.fromkeys(("free-inertial", "complementary", "graph-smoother"), 6),
    **dict.fromkeys(("smoother", "ukf", "gnss-only", "ahrs"), 4),
    **dict.fromkeys(("baro-inertial", "classic-22", "tight"), 5),
    **dict.fromkeys(("loose-22", "invariant-ekf", "autopilot"), 3),
}
"""Built-in filter -> its slot; those that profiles fly together have different ones."""


class DrawnLook(NamedTuple):
    """Color and dash of the lines of a filter."""

    color: Color  # its tone on dark ground
    dashed: bool  # another one of the same picture has the color
    name: str  # of the color


def choose_looks(labels: Iterable[str]) -> dict[str, DrawnLook]:
    """Return the look of each estimator: its own color, or the first free one; dashed if none is free.

    In a comparison labels are "filter, result": a filter keeps its color, and the dash is the result.

    Examples
    --------
    >>> [look.name for look in choose_looks(["loose-15", "mine"]).values()]
    ['red', 'blue']
    """
    labels = list(labels)
    slots = {label: slot for label in labels if (slot := _OWNERS.get(label.partition(", ")[0]))}
    for label in labels:
        if label not in slots:
            free = [k for k in range(1, len(SLOTS)) if k not in slots.values()]
            slots[label] = free[0] if free else 1 + len(slots) % (len(SLOTS) - 1)
    seen: set[int] = set()
    looks = {}
    for label in labels:
        slot = slots[label]
        looks[label] = DrawnLook(SLOTS[slot].dark, slot in seen, SLOTS[slot].name)
        seen.add(slot)
    return looks


def find_slot(color: Color) -> int | None:
    """Return the number of the tone of a color, as its CSS variable has it; None if it has none."""
    return next((k for k, slot in enumerate(_TONES) if slot.dark == color), None)


def find_light(color: Color) -> Color | None:
    """Return the tone on light ground of a color on dark ground; None if it has none."""
    return next((slot.light for slot in _TONES if slot.dark == color), None)


def write_variables(*, dark: bool) -> str:
    """Return the tones for a ground as CSS variables, the slots as ``--s0`` to ``--s6``.

    Examples
    --------
    >>> write_variables(dark=False)[:13]
    '--s0:#31a17e;'
    """
    tones = (slot.dark if dark else slot.light for slot in _TONES)
    return "".join(f"--s{k}:#{r:02x}{g:02x}{b:02x};" for k, (r, g, b) in enumerate(tones))
