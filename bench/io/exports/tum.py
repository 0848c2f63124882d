"""TUM poses (t x y z qx qy qz qw), for evo and the tools of the TUM RGB-D benchmark."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from bench.core.mathematics import rotation
from bench.core.words.exceptions import ExportError
from bench.io.exports.local import to_poses
from bench.io.exports.outgoing import ExportData
from bench.io.results import parquet

FORMATS = {"tum": "poses, east-north-up, for evo and the TUM tools: --with truth or --with solution:NAME"}


def write(folder: Path, out: ExportData, kind: str) -> str:
    """Write one file per track; return their description for the README."""
    if not out.tracks:
        raise ExportError("tum contains poses, not sensors: add --with truth or --with solution:NAME")
    origin, names = None, ""
    for name, track in out.tracks.items():
        known = np.isfinite(np.hstack([track.lla, track.q_nb])).all(axis=1)
        if not known.any():
            raise ExportError(f"{name} has no position with an attitude, which tum needs")
        lla = track.lla[known]
        origin = lla[0] if origin is None else origin
        position, attitude = to_poses(lla, track.q_nb[known], origin)
        rows = np.column_stack([track.t[known], position, rotation.to_scalar_last(attitude)])
        lat, lon = np.rad2deg(origin[:2])
        place = f"origin_lat_deg={lat:.12f} origin_lon_deg={lon:.12f} origin_alt_m={origin[2]:.6f}"
        parquet.write_rows(folder / f"{name}.tum", rows, f"# {place} frame=enu-flu\n")
        lost = len(track.t) - len(lla)
        remark = f"; {lost} epochs without one are left out" if lost else ""
        names += f"- `{name}.tum`, {len(lla)} poses of the IMU{remark}\n"
    assert origin is not None
    lat, lon = np.rad2deg(origin[:2])
    return f"""TUM trajectories, one row `t x y z qx qy qz qw` per pose: [s], [m], quaternion scalar last.

{names}
x, y, z are east, north, up in the tangent frame at latitude {lat:.9f} deg, longitude {lon:.9f} deg, height
{origin[2]:.3f} m. The quaternion rotates a vector from the body frame (forward, left, up) to that frame.
`bench score` reads the place of the frame in the first line, a comment.
Example: `evo_ape tum truth.tum solution-loose-15.tum`."""
