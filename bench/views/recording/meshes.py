"""Simple shapes of the aircraft classes, in body axes."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Any

import numpy as np

from bench.core.mathematics.arrays import FloatArray

Triangles = np.ndarray[Any, np.dtype[np.int64]]
Mesh = tuple[FloatArray, Triangles, Triangles]
"""Vertices (V, 3) in frame b with a wing span of 1, triangles (T, 3), a color per triangle (T, 3)."""

_ANGLE = np.linspace(0.0, 2 * np.pi, 8, endpoint=False)
_CIRCLE = np.column_stack([0 * _ANGLE, np.cos(_ANGLE), np.sin(_ANGLE)])
_FOIL = np.array([[0.5, 0, 0], [0.2, 0, -0.06], [-0.5, 0, 0], [0.2, 0, 0.04]])  # of chord 1
_FIN = np.array([[0.5, 0, 0], [0.2, 0.05, 0], [-0.5, 0, 0], [0.2, -0.05, 0]])

_BODY, _WHITE, _DARK, _ORANGE = [225, 228, 232], [245, 245, 245], [90, 95, 105], [255, 170, 60]
_RED, _GREEN = [225, 50, 50], [40, 190, 80]  # the tips, left and right


def _make_loft(*rings: Any) -> tuple[FloatArray, Triangles]:
    """Return the closed surface over rings with equal numbers of points (K, 3), normals outward."""
    points = np.array(rings, float)
    n, k = points.shape[:2]
    j = np.arange(k)
    faces = []
    for i in range(n - 1):
        a, b = i * k + j, i * k + (j + 1) % k
        faces += [np.column_stack([a, b, b + k]), np.column_stack([a, b + k, a + k])]
    fan = np.column_stack([0 * j[1:-1], j[1:-1], j[2:]])
    faces += [fan[:, ::-1], fan + (n - 1) * k]
    vertices, triangles = points.reshape(-1, 3), np.vstack(faces)
    a, b, c = (vertices[triangles[:, i]] for i in range(3))
    inside_out = np.sum(a * np.cross(b, c)) < 0.0  # six times the volume
    return vertices, triangles[:, ::-1] if inside_out else triangles


def _make_ring(x: float, radius: float, z: float = 0.0, y: float = 0.0) -> FloatArray:
    return np.array([x, y, z]) + radius * _CIRCLE


def _make_rings(*stations: tuple[float, ...]) -> list[FloatArray]:
    """Return rings at stations (x, radius, z, y); z and y are 0 if left out."""
    return [_make_ring(*station) for station in stations]


def _make_foil(x: float, y: float, z: float, chord: float) -> FloatArray:
    return np.array([x, y, z]) + chord * _FOIL


def _make_fin(x: float, z: float, chord: float) -> FloatArray:
    return np.array([x, 0.0, z]) + chord * _FIN


def _mirror_foils(*sections: tuple[float, float, float, float]) -> tuple[FloatArray, ...]:
    """Return foils from left to right for the sections (x, y, z, chord) of the right half, y = 0 first."""
    left = [(x, -y, z, chord) for x, y, z, chord in sections[:0:-1]]
    return tuple(_make_foil(*section) for section in (*left, *sections))


def _make_wing(*sections: tuple[float, float, float, float]) -> list[tuple[Sequence[FloatArray], list[int]]]:
    """Return a wing from the sections (x, y, z, chord) of its right half; the last panels are the tips."""
    foils = _mirror_foils(*sections)
    return [(foils[1:-1], _WHITE), (foils[:2], _RED), (foils[-2:], _GREEN)]


def _join_parts(parts: Iterable[tuple[Sequence[FloatArray], list[int]]]) -> Mesh:
    """Join the surfaces of all parts into one mesh."""
    vertices, triangles, colors, start = [], [], [], 0
    for rings, color in parts:
        points, faces = _make_loft(*rings)
        vertices.append(points)
        triangles.append(faces + start)
        colors.append(np.tile(color, (len(faces), 1)))
        start += len(points)
    return np.vstack(vertices), np.vstack(triangles), np.vstack(colors)


def _make_uav() -> Mesh:
    """Return a small twin-boom pusher."""

    def make_boom(y: float) -> list[FloatArray]:
        return [_make_ring(x, 0.010, -0.03, y) for x in (0.0, -0.38)]

    body = _make_rings((0.36, 0.006), (0.30, 0.04), (0.15, 0.06), (-0.10, 0.06), (-0.20, 0.03))
    return _join_parts(
        [
            (body, _BODY),
            *_make_wing((0.0, 0.0, -0.04, 0.17), (0.02, 0.40, -0.04, 0.13), (0.03, 0.50, -0.05, 0.10)),
            (make_boom(-0.14), _DARK),
            (make_boom(0.14), _DARK),
            (_mirror_foils((-0.40, 0.0, -0.16, 0.09), (-0.38, 0.14, -0.03, 0.10)), _ORANGE),
        ]
    )


def _make_light_single() -> Mesh:
    """Return a low-wing single with a canopy and a propeller disc."""
    body = _make_rings(
        (0.30, 0.025, 0.01),
        (0.27, 0.050, 0.01),
        (0.10, 0.066, 0.0),
        (-0.08, 0.064, 0.0),
        (-0.50, 0.015, -0.02),
    )
    canopy = [
        _make_ring(x, radius, -0.05)
        for x, radius in ((0.09, 0.008), (0.05, 0.045), (-0.06, 0.045), (-0.16, 0.008))
    ]
    return _join_parts(
        [
            (body, _BODY),
            (canopy, _DARK),
            ([_make_ring(0.302, 0.115, 0.01), _make_ring(0.308, 0.115, 0.01)], _DARK),
            *_make_wing((0.02, 0.0, 0.05, 0.21), (0.02, 0.40, 0.02, 0.15), (0.02, 0.50, 0.01, 0.12)),
            (_mirror_foils((-0.46, 0.0, -0.03, 0.12), (-0.46, 0.20, -0.03, 0.08)), _ORANGE),
            ([_make_fin(-0.44, -0.01, 0.16), _make_fin(-0.49, -0.17, 0.08)], _ORANGE),
        ]
    )


def _make_jet() -> Mesh:
    """Return a swept low-wing transport with four engines under the wing."""
    body = _make_rings(
        (0.52, 0.008, 0.01),
        (0.49, 0.030, 0.0),
        (0.42, 0.050, 0.0),
        (-0.25, 0.050, 0.0),
        (-0.56, 0.010, -0.03),
    )

    def make_engine(x: float, y: float) -> list[FloatArray]:
        return [
            _make_ring(x + dx, radius, 0.065, y)
            for dx, radius in ((0.05, 0.018), (0.02, 0.022), (-0.05, 0.012))
        ]

    return _join_parts(
        [
            (body, _BODY),
            *_make_wing((0.06, 0.0, 0.03, 0.26), (-0.15, 0.40, 0.0, 0.09), (-0.22, 0.50, -0.01, 0.06)),
            *(
                (make_engine(x, side * y), _DARK)
                for x, y in ((0.08, 0.20), (-0.03, 0.34))
                for side in (-1, 1)
            ),
            (_mirror_foils((-0.44, 0.0, -0.03, 0.14), (-0.56, 0.19, -0.05, 0.05)), _ORANGE),
            ([_make_fin(-0.42, -0.03, 0.18), _make_fin(-0.56, -0.21, 0.07)], _ORANGE),
        ]
    )


def _make_multirotor() -> Mesh:
    """Return four rotors in an X, orange those ahead, on arms with legs."""

    def make_rod(begin: FloatArray, end: FloatArray, radius: float) -> list[FloatArray]:
        axis = (end - begin) / np.linalg.norm(end - begin)
        across = np.cross(axis, [0.6, 0.0, 0.8] if abs(axis[2]) < 0.7 else [1.0, 0.0, 0.0])
        across /= np.linalg.norm(across)
        circle = _CIRCLE[:, 1:] @ np.array([across, np.cross(axis, across)])
        return [begin + radius * circle, end + radius * circle]

    down, parts = np.array([0.0, 0.0, 0.12]), []
    for x in (0.28, -0.28):
        for y in (-0.28, 0.28):
            hub = np.array([x, y, 0.0])
            parts += [(make_rod(np.zeros(3), hub, 0.02), _BODY), (make_rod(hub, hub + down, 0.012), _DARK)]
            disk = make_rod(hub - 0.25 * down, hub - 0.35 * down, 0.22)
            parts.append((disk, _ORANGE if x > 0.0 else _WHITE))
    body = make_rod(-0.5 * down, 0.5 * down, 0.10)
    return _join_parts([*parts, (body, _DARK)])


def _make_helicopter() -> Mesh:
    """Return a main rotor on a mast, a body with a boom, and a tail rotor in orange."""

    def make_disk(center: tuple[float, float, float], radius: float, axis: int) -> list[FloatArray]:
        across = np.roll(np.eye(3), -axis, axis=0)[1:]
        thick = 0.01 * np.eye(3)[axis]
        circle = np.array(center) + radius * _CIRCLE[:, 1:] @ across
        return [circle - thick, circle + thick]

    body = [np.array([x, 0.0, 0.05]) + r * _CIRCLE for x, r in ((0.3, 0.02), (0.1, 0.14), (-0.25, 0.1))]
    boom = [np.array([x, 0.0, -0.02]) + 0.025 * _CIRCLE for x in (-0.25, -1.04)]
    mast = make_disk((0.0, 0.0, -0.2), 0.02, 2)
    mast[0], mast[1] = mast[0] - [0.0, 0.0, 0.12], mast[1] + [0.0, 0.0, 0.15]
    rotors = (
        (make_disk((0.0, 0.0, -0.34), 0.7, 2), _WHITE),
        (make_disk((-1.04, 0.06, -0.1), 0.13, 1), _ORANGE),
    )
    return _join_parts([(body, _BODY), (boom, _BODY), (mast, _DARK), *rotors])


MESHES = {
    "multirotor": _make_multirotor,
    "helicopter": _make_helicopter,
    "uav": _make_uav,
    "light-single": _make_light_single,
    "jet": _make_jet,
}
"""Shapes by ``AircraftSpec.mesh``."""
