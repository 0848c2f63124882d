"""The colors of pages, recordings and figures are told apart by everybody, on light and on dark ground."""

from __future__ import annotations

from itertools import combinations

import numpy as np
import pytest
from numpy.testing import assert_allclose

from bench.core.files.places import PACKAGE
from bench.core.words.palette import FIXES, SLOTS, choose_looks
from bench.navigation.built_in import BUILT_IN

COLORS = (*SLOTS, FIXES)
GROUNDS = {"light": ("#ffffff", "#f6f8fa"), "dark": ("#0f1318", "#181d24")}
"""Of a page and of a plot, as page.css has them."""
TO_XYZ = np.array(
    [[0.4124564, 0.3575761, 0.1804375], [0.2126729, 0.7151522, 0.0721750], [0.0193339, 0.1191920, 0.9503041]]
)
CONES = {
    "normal": np.eye(3),
    "protan": [
        [0.152286, 1.052583, -0.204868],
        [0.114503, 0.786281, 0.099216],
        [-0.003882, -0.048116, 1.051998],
    ],
    "deutan": [
        [0.367322, 0.860646, -0.227968],
        [0.280085, 0.672501, 0.047413],
        [-0.011820, 0.042940, 0.968881],
    ],
    "tritan": [
        [1.255528, -0.076749, -0.178779],
        [-0.078411, 0.930809, 0.147602],
        [0.004733, 0.691367, 0.303900],
    ],
}
"""Sight -> what it makes of linear sRGB: Machado, Oliveira and Fernandes 2009, severity 1.0."""


def linearize(color) -> np.ndarray:
    c = np.asarray(color, float) / 255.0
    return np.where(c <= 0.04045, c / 12.92, ((c + 0.055) / 1.055) ** 2.4)


def to_lab(linear: np.ndarray) -> np.ndarray:
    ratio = TO_XYZ @ np.clip(linear, 0.0, 1.0) / TO_XYZ.sum(axis=1)
    f = np.where(ratio > (6 / 29) ** 3, np.cbrt(ratio), ratio / (3 * (6 / 29) ** 2) + 4 / 29)
    return np.array([116 * f[1] - 16, 500 * (f[0] - f[1]), 200 * (f[1] - f[2])])


def ciede2000(one, other) -> float:
    """Sharma, Wu and Dalal, Color Research and Application 30 (2005)."""
    (l1, a1, b1), (l2, a2, b2) = one, other
    mean = 0.5 * (np.hypot(a1, b1) + np.hypot(a2, b2))
    g = 0.5 * (1 - np.sqrt(mean**7 / (mean**7 + 25.0**7)))
    a1, a2 = (1 + g) * a1, (1 + g) * a2
    c1, c2 = np.hypot(a1, b1), np.hypot(a2, b2)
    h1, h2 = (np.degrees(np.arctan2(b, a)) % 360 for a, b in ((a1, b1), (a2, b2)))
    dh = (h2 - h1 + 180) % 360 - 180
    far = 2 * np.sqrt(c1 * c2) * np.sin(np.radians(dh) / 2)
    low, c = 0.5 * (l1 + l2), 0.5 * (c1 + c2)
    h = (h1 + 0.5 * dh) % 360
    t = 1 - 0.17 * np.cos(np.radians(h - 30)) + 0.24 * np.cos(np.radians(2 * h))
    t += 0.32 * np.cos(np.radians(3 * h + 6)) - 0.20 * np.cos(np.radians(4 * h - 63))
    sl = 1 + 0.015 * (low - 50) ** 2 / np.sqrt(20 + (low - 50) ** 2)
    sc, sh = 1 + 0.045 * c, 1 + 0.015 * c * t
    turn = -2 * np.sqrt(c**7 / (c**7 + 25.0**7)) * np.sin(np.radians(60 * np.exp(-(((h - 275) / 25) ** 2))))
    x, y, z = (l2 - l1) / sl, (c2 - c1) / sc, far / sh
    return float(np.sqrt(x * x + y * y + z * z + turn * y * z))


def luminance(color) -> float:
    return float(TO_XYZ[1] @ linearize(color))


def read_hex(text: str) -> tuple[int, ...]:
    return tuple(bytes.fromhex(text[1:]))


@pytest.mark.parametrize(
    ("one", "other", "apart"),
    [
        ((50.0, 2.6772, -79.7751), (50.0, 0.0, -82.7485), 2.0425),
        ((50.0, 2.5, 0.0), (50.0, 0.0, -2.5), 4.3065),
        ((60.2574, -34.0099, 36.2677), (60.4626, -34.1751, 39.4387), 1.2644),
        ((2.0776, 0.0795, -1.1350), (0.9033, -0.0636, -0.5514), 0.9082),
    ],
)
def test_the_distance_is_that_of_its_authors(one, other, apart):
    """Pairs 1, 17, 25 and 34 of their table."""
    assert ciede2000(one, other) == pytest.approx(apart, abs=6e-5)


@pytest.mark.parametrize("sight", CONES)
@pytest.mark.parametrize("ground", GROUNDS)
def test_any_two_colors_are_told_apart(ground, sight):
    seen = [to_lab(np.asarray(CONES[sight]) @ linearize(getattr(slot, ground))) for slot in COLORS]
    apart = {
        (COLORS[i].name, COLORS[j].name): ciede2000(seen[i], seen[j])
        for i, j in combinations(range(len(COLORS)), 2)
    }
    assert len(apart) == 28
    assert min(apart.values()) >= 20.0, min(apart, key=lambda pair: apart[pair])


def test_no_color_on_light_ground_is_nearly_black():
    assert min(to_lab(linearize(slot.light))[0] for slot in SLOTS) > 25.0


@pytest.mark.parametrize("ground", GROUNDS)
def test_every_color_stands_out_from_its_ground(ground):
    style = (PACKAGE / "views" / "report" / "page.css").read_text()
    for back in GROUNDS[ground]:
        assert back.replace("#ffffff", "#fff") in style
        for slot in COLORS:
            low, high = sorted((luminance(getattr(slot, ground)), luminance(read_hex(back))))
            assert (high + 0.05) / (low + 0.05) >= 3.0, slot.name


def test_the_cones_are_those_of_colorspacious():
    colorspacious = pytest.importorskip("colorspacious")
    kinds = {"protan": "protanomaly", "deutan": "deuteranomaly", "tritan": "tritanomaly"}
    for sight, kind in kinds.items():
        space = {"name": "sRGB1+CVD", "cvd_type": kind, "severity": 100}
        color = SLOTS[1].dark
        seen = colorspacious.cspace_convert(np.array(color) / 255.0, space, "sRGB1-linear")
        assert_allclose(np.asarray(CONES[sight]) @ linearize(color), seen, atol=2e-4)


def test_a_filter_has_the_same_color_wherever_it_is_drawn():
    alone, many = (
        choose_looks(["loose-15"]),
        choose_looks(["mine", "loose-full", "loose-15", "free-inertial"]),
    )
    assert alone["loose-15"] == many["loose-15"]
    assert len({look.color for look in many.values()}) == 4
    assert not any(look.dashed for look in many.values())
    compared = choose_looks(["loose-15, before", "loose-15, after"])
    assert [look.dashed for look in compared.values()] == [False, True]
    assert len({look.color for look in compared.values()}) == 1
    every = choose_looks(BUILT_IN)
    assert set(every) == set(BUILT_IN)
    assert {look.color for look in every.values()} == {slot.dark for slot in SLOTS[1:]}
