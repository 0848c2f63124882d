"""The flight in space: paths, aircraft and fixes in the local level frame of the start, and on the map."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
import rerun as rr

from bench.core.files import disk_arrays
from bench.core.mathematics import earth, rotation
from bench.core.mathematics.arrays import FloatArray
from bench.core.records.data import GnssFixes, NavSolution, Trajectory
from bench.core.records.findings.series import (
    AXIS_COLORS,
    BAND,
    FIX,
    MOST_ROWS,
    SLOW,
    TRUTH,
    limit_rate,
    round_number,
    thin,
)
from bench.core.records.specs import IN_FLIGHT
from bench.core.words.palette import Color
from bench.views.plots.content import Content
from bench.views.recording.drawing import TIMELINE, entity
from bench.views.recording.meshes import MESHES

_CALM = 0.1  # less wind has no arrow [m/s]
_OBSTACLE = 15.0  # take-off and landing distances count to this height [m]
_ABREAST = 200.0  # of a runway: a low flight farther beside it is none of it [m]


@dataclass(frozen=True, slots=True)
class Scene:
    """Extent of the flight, and the entities of the views in space."""

    end: float  # of the flight [s]
    low: FloatArray  # (3,) corner of the box around the true path [m], local NED
    high: FloatArray  # (3,) its other corner
    lat: float  # middle of the flight [rad]
    fixes: tuple[str, ...]  # entities shown up to the cursor
    hidden: tuple[str, ...]  # entities that are there but switched off

    @property
    def size(self) -> float:
        """Length of the longer horizontal side of the box [m]."""
        return float(max(self.high[0] - self.low[0], self.high[1] - self.low[1], 1.0))

    @property
    def grid(self) -> float:
        """Distance of the lines of the ground grid [m]."""
        return round_number(self.size / 5.0)


def make_scene(content: Content) -> Scene:
    """Make the scene of the views in space; all filters are hidden but the first and what flew."""
    truth = content.motion
    lla = disk_arrays.take(truth.lla, thin(truth.t))
    path = earth.local_ned(lla, truth.lla[0])
    others = [label for label in list(content.solutions)[1:] if label != IN_FLIGHT]
    return Scene(
        end=float(truth.t[-1]),
        low=path.min(axis=0),
        high=path.max(axis=0),
        lat=float(lla[:, 0].mean()),
        fixes=("/world/gnss/fixes", "/map/gnss/fixes") if content.sensed.data.fixes is not None else (),
        hidden=tuple(
            entity(root, "estimators", label, "path") for root in ("world", "map") for label in others
        ),
    )


def send(stream: Any, scene: Mapping[str, Any], content: Content) -> None:
    """Send paths, aircraft and fixes in the local level frame of the start, and the same on the map.

    Without a truth the vehicle is where the first filter has it. Without a mesh of `MESHES` in the scene
    of the result it is a set of body axes.
    """
    mesh = scene.get("mesh")
    truth, solutions, colors = content.motion, content.solutions, content.colors
    origin = truth.lla[0]
    keep = thin(truth.t, limit_rate(truth.t, MOST_ROWS))
    t, lla, q_nb = (disk_arrays.take(column, keep) for column in (truth.t, truth.lla, truth.q_nb))
    pos = earth.local_ned(lla, origin)
    size = float(np.ptp(pos[:, :2], axis=0).max())
    stream.log("/world", rr.ViewCoordinates.FRD, static=True)
    stream.log(
        "/world/axes",
        rr.Arrows3D(
            origins=[pos.min(axis=0) * [1, 1, 0]] * 2,
            vectors=0.25 * size * np.eye(3)[:2],
            colors=AXIS_COLORS[:2],
            labels=["north", "east"],
            show_labels=True,
        ),
        static=True,
    )
    if isinstance(truth, Trajectory):
        _send_path(stream, "/truth", lla, origin, TRUTH)
        if scene.get("runway"):
            _send_runway(stream, scene["runway"], lla, origin)
    for number, stretch in enumerate(content.desired):
        _send_path(stream, f"/desired/{number}", stretch, origin, BAND)
    for label, solution in solutions.items():
        sound = solution.lla[np.isfinite(solution.lla).all(axis=1)]
        if len(sound):
            _send_path(stream, entity("estimators", label), sound, origin, colors[label])

    time = [rr.TimeColumn(TIMELINE, duration=t)]
    vehicle = "truth/aircraft" if isinstance(truth, Trajectory) else "vehicle"
    _send_vehicle(stream, f"/world/{vehicle}", mesh, size)
    q_sb = _convert_to_start_frame(q_nb, lla, origin)
    stream.send_columns(
        f"/world/{vehicle}",
        time,
        rr.Transform3D.columns(translation=pos, quaternion=rotation.to_scalar_last(q_sb)),
    )
    if isinstance(truth, Trajectory):
        _send_wind(stream, truth, origin, size)
        main = next(iter(solutions), None)
        if main is not None:
            _send_estimate(stream, main, solutions[main], colors[main], mesh, origin, size)
    color = TRUTH if isinstance(truth, Trajectory) else next(iter(colors.values()))
    stream.log(f"/map/{vehicle}", rr.GeoPoints.from_fields(colors=[color], radii=[-7.0]), static=True)
    slow = thin(truth.t, limit_rate(truth.t, SLOW))
    stream.send_columns(
        f"/map/{vehicle}",
        [rr.TimeColumn(TIMELINE, duration=disk_arrays.take(truth.t, slow))],
        rr.GeoPoints.columns(positions=np.rad2deg(disk_arrays.take(truth.lla, slow)[:, :2])),
    )

    if content.sensed.data.fixes is not None:
        _send_fixes(stream, content.sensed.data.fixes, origin)


def _send_fixes(stream: Any, fixes: GnssFixes, origin: FloatArray) -> None:
    good = np.flatnonzero(fixes.valid & np.isfinite(fixes.lla).all(axis=1))
    good = good[thin(fixes.t[good], limit_rate(fixes.t, MOST_ROWS))]
    time = [rr.TimeColumn(TIMELINE, duration=fixes.t[good])]
    for place, points, positions in (
        ("/world/gnss/fixes", rr.Points3D, earth.local_ned(fixes.lla[good], origin)),
        ("/map/gnss/fixes", rr.GeoPoints, np.rad2deg(fixes.lla[good, :2])),
    ):
        stream.log(place, points.from_fields(colors=[FIX], radii=[-1.2]), static=True)
        stream.send_columns(place, time, points.columns(positions=positions))


def _send_estimate(
    stream: Any,
    label: str,
    solution: NavSolution,
    color: Color,
    mesh: str | None,
    origin: FloatArray,
    size: float,
) -> None:
    """Send the aircraft as the main filter has it, in its color, and its 3 sigma ellipsoid."""
    good = np.isfinite(np.hstack([solution.lla, solution.q_nb])).all(axis=1)
    rows = np.flatnonzero(good)[thin(solution.t[good], limit_rate(solution.t, SLOW))]
    if not len(rows):
        return
    place, time = entity("world", "estimators", label), [rr.TimeColumn(TIMELINE, duration=solution.t[rows])]
    lla = solution.lla[rows]
    pos, q_sb = earth.local_ned(lla, origin), _convert_to_start_frame(solution.q_nb[rows], lla, origin)
    _send_vehicle(stream, f"{place}/aircraft", mesh, size, color)
    stream.send_columns(
        f"{place}/aircraft",
        time,
        rr.Transform3D.columns(translation=pos, quaternion=rotation.to_scalar_last(q_sb)),
    )
    cov = disk_arrays.take(solution.cov, rows)[:, :3, :3]
    known = np.isfinite(cov).all(axis=(1, 2))
    if not known.any():
        return
    variances, axes = np.linalg.eigh(cov[known])
    axes[:, :, 0] *= np.sign(np.linalg.det(axes))[:, None]  # a rotation, no reflection
    stream.log(
        f"{place}/ellipsoid",
        rr.Ellipsoids3D.from_fields(colors=[color], line_radii=[-0.8], fill_mode="majorwireframe"),
        static=True,
    )
    stream.send_columns(
        f"{place}/ellipsoid",
        [rr.TimeColumn(TIMELINE, duration=solution.t[rows][known])],
        rr.Ellipsoids3D.columns(
            half_sizes=3.0 * np.sqrt(np.maximum(variances, 0.0)),
            centers=pos[known],
            quaternions=rotation.to_scalar_last(rotation.from_matrix(axes)),
        ),
    )


def _send_wind(stream: Any, truth: Trajectory, origin: FloatArray, size: float) -> None:
    """Send an arrow at the aircraft that points where the wind blows; 10 m/s are as long as the aircraft."""
    air = truth.air
    if not len(air.t) or not np.isfinite(air.wind_n).all() or np.abs(air.wind_n).max() < _CALM:
        return
    keep = thin(air.t, limit_rate(air.t, SLOW))
    at = np.clip(np.searchsorted(truth.t, air.t[keep] - 1e-6), 0, len(truth) - 1)
    stream.log("/world/wind", rr.Arrows3D.from_fields(colors=[BAND], labels=["wind"]), static=True)
    stream.send_columns(
        "/world/wind",
        [rr.TimeColumn(TIMELINE, duration=air.t[keep])],
        rr.Arrows3D.columns(
            vectors=air.wind_n[keep] * (0.012 * max(size, 8.0)),
            origins=earth.local_ned(disk_arrays.take(truth.lla, at), origin),
        ),
    )


def _send_vehicle(stream: Any, place: str, mesh: str | None, size: float, color: Color | None = None) -> None:
    """Send the shape of the vehicle, in its own color if one is given; body axes without a mesh."""
    scale = max(1.0, 0.12 * size)
    if mesh not in MESHES:
        axes = rr.Arrows3D(vectors=0.5 * scale * np.eye(3), colors=AXIS_COLORS)
        stream.log(place, axes, static=True)
        return
    vertices, triangles, paint = MESHES[mesh]()
    vertices = vertices * scale
    corners = vertices[triangles]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    stream.log(
        place,
        rr.Mesh3D(
            vertex_positions=corners.reshape(-1, 3),
            vertex_normals=np.repeat(normals, 3, axis=0),
            vertex_colors=np.repeat(paint, 3, axis=0)
            if color is None
            else np.tile(color, (corners.size // 3, 1)),
        ),
        static=True,
    )


def _send_runway(stream: Any, runway: Mapping[str, float], lla: FloatArray, origin: FloatArray) -> None:
    """Send the runway from its threshold on, as far as the flight is low over or beside it, if it moves."""
    threshold = np.array([np.deg2rad(runway["lat_deg"]), np.deg2rad(runway["lon_deg"]), runway["alt_m"]])
    heading = np.deg2rad(runway["heading_deg"])
    along, across = (
        np.array([np.cos(heading), np.sin(heading)]),
        np.array([-np.sin(heading), np.cos(heading)]),
    )
    pos = earth.local_ned(lla, threshold)
    over = (-pos[:, 2] < _OBSTACLE) & (np.abs(pos[:, :2] @ across) < _ABREAST)
    used = pos[over, :2] @ along
    if not len(used) or np.ptp(used) < runway["width_m"]:
        return
    length = 100.0 * np.ceil(float(used.max()) / 100.0)
    edges = ((0.0, -0.5), (length, -0.5), (length, 0.5), (0.0, 0.5), (0.0, -0.5))
    outline = np.array([x * along + y * runway["width_m"] * across for x, y in edges])
    lines = [outline, np.array([0.0 * along, length * along])]
    on_ground = [earth.displace(threshold, np.column_stack([line, np.zeros(len(line))])) for line in lines]
    stream.log(
        "/world/runway",
        rr.LineStrips3D(
            [earth.local_ned(line, origin) for line in on_ground],
            colors=[BAND],
            radii=[-1.5, -0.5],
            labels=["runway", ""],
            show_labels=True,
        ),
        static=True,
    )
    stream.log(
        "/map/runway",
        rr.GeoLineStrings(
            lat_lon=[np.rad2deg(line[:, :2]) for line in on_ground], colors=[BAND], radii=[-1.0, -1.0]
        ),
        static=True,
    )


def _send_path(stream: Any, branch: str, lla: FloatArray, origin: FloatArray, color: Color) -> None:
    """Send a path in space and on the map, with every fifth point."""
    lla = np.vstack([lla[:-1:5], lla[-1:]])
    stream.log(
        f"/world{branch}/path",
        rr.LineStrips3D([earth.local_ned(lla, origin)], colors=[color], radii=[-1.0]),
        static=True,
    )
    stream.log(
        f"/map{branch}/path",
        rr.GeoLineStrings(lat_lon=[np.rad2deg(lla[:, :2])], colors=[color], radii=[-1.0]),
        static=True,
    )


def _convert_to_start_frame(q_nb: FloatArray, lla: FloatArray, origin: FloatArray) -> FloatArray:
    """Return the attitude q_sb (N, 4) relative to the local level frame of the start."""
    C_es = earth.matrix_en(origin[0], origin[1])
    C_sn = C_es.T @ earth.matrix_en(lla[:, 0], lla[:, 1])
    return rotation.multiply(rotation.from_matrix(C_sn), q_nb)
