"""The reference of a log: the same motion measured by another system, and its use in evaluation.

The reference may be any file that fixes or solutions are read from. Solution and reference have different
times: the record with more rows is interpolated at the epochs of the other, never across a gap.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from bench.core.mathematics import rotation
from bench.core.mathematics.arrays import FloatArray
from bench.core.mathematics.earth import difference_n, displace, matrix_en
from bench.core.records.data import GnssFixes, NavSolution
from bench.core.records.run_records import Reference
from bench.core.words.exceptions import ConfigError
from bench.evaluation.errors.reference_errors import take_as_read
from bench.evaluation.errors.resampling import resample
from bench.evaluation.motion.recorded_motion import Check
from bench.io.config.log import ReferenceSpec, SourceSpec
from bench.io.foreign.local_frames import NONE, YAW, align
from bench.io.foreign.run_clock import RunClock
from bench.io.foreign.solution_rows import Placing, reject_placing
from bench.io.foreign.solutions import DEVIATIONS, read_attitudes, read_solution
from bench.io.log_formats import NAV, find_format
from bench.io.logs import formats
from bench.io.logs.formats.pose_files import read_poses
from bench.io.logs.local_tables import place_rows
from bench.io.logs.own_estimate import NEAR, look, read_truth
from bench.io.logs.record_clock import meet_week, unwrap_week
from bench.io.logs.rows import GNSS, MOST_ROWS, OPTIONAL, LogRows
from bench.io.logs.table_files import check_times, read_table
from bench.io.trajectories.trajectory import KINDS

_TABLE = {
    **GNSS,
    "position sd": (*GNSS["position sd"], *DEVIATIONS["sd_pos"]),
    "velocity sd": (*GNSS["velocity sd"], *DEVIATIONS["sd_vel"]),
    "attitude": KINDS["attitude"],
    "attitude sd": DEVIATIONS["sd_phi"],
}
"""Columns of a table: those of fixes or of a solution."""
_FEWEST = 3  # rows
_FAR, _SIGMAS = 20.0, 5.0  # distance to the fixes that is wrong: beyond [m], and so many of their sd


def read_reference(
    spec: ReferenceSpec, origin: float, last: float, fixes: GnssFixes, antenna_b: FloatArray
) -> tuple[Reference, list[Check]]:
    """Read the reference of a log; align it with the fixes if its positions are local.

    Parameters
    ----------
    spec : ReferenceSpec
        The file, and how the unit is mounted.
    origin, last : float
        t = 0 on the clock of the files, and the end of the IMU record after it [s].
    fixes : GnssFixes
        Fixes of the log.
    antenna_b : (3,) array
        Their point relative to the IMU [m], b.

    Returns
    -------
    reference : Reference
        Without covariance if it is aligned.
    checks : list of Check
        Its clock and the alignment.

    Raises
    ------
    ConfigError
        If the file cannot be read, lacks columns, or none of its rows can judge: one line.
    """
    source, shown = spec.source, spec.source.path.name
    kind, begin, checks = NONE, origin, list[Check]()
    is_local = source.format == "poses" and bool(read_poses(source.path).frame)
    wanted = None if spec.align == NONE else spec.align
    if not is_local and source.format != "table":
        reject_placing(shown, frame=source.frame, origin=source.origin, align=wanted)
    near = fixes.lla[np.argmax(fixes.valid)] if fixes.valid.any() else None
    placing = Placing(source.frame, source.origin, near)
    if source.path.suffix.lower() == NAV or is_local:
        found = read_solution(source.path, placing=placing)
        if is_local:
            clock = RunClock.of_log(0.0, last, origin)
            begin, remark = clock.find_start(found.t + source.time_offset, found.clock)
            checks += [Check("reference_clock_s", begin, f"reference: {remark}", True)] if remark else []
            kind = _choose_alignment(spec, found.placed)
        t, lla, vel_n, q_nb = found.t, found.lla, found.vel_n, found.q_nb
        cov = np.zeros((len(t), 9, 9)) if found.cov is None else found.cov
        good = np.ones(len(t), np.bool_)
        values: dict[str, FloatArray] = {}
    else:
        rows, q_nb, sd_phi, placed = _read_rows(spec, placing)
        kind = NONE if placed is None else _choose_alignment(spec, placed)
        reject_placing(shown, align=wanted if placed is None else None)
        rows = meet_week(unwrap_week(rows, shown), origin, origin + last)
        t, values = rows.t, dict(rows.values)
        lla, vel_n = values["lla"], values.get("vel_n", np.full((len(t), 3), np.nan))
        cov = make_covariance(values, sd_phi, len(t))
        good = values.get("valid", np.ones(len(t))) > 0
    if spec.quality:
        if "quality" not in values:
            raise ConfigError(f"{shown}: [reference] quality is set, but the file has no column quality")
        good &= np.isin(values["quality"], spec.quality)
    good &= np.isfinite(lla).all(axis=1) & lla[:, :2].any(axis=1) & np.isfinite(t)
    for block in (vel_n, q_nb):
        known = np.asarray(np.isfinite(block).all(axis=1))
        if 2 * known.sum() > len(known):
            good &= known
        else:
            block[:] = np.nan
    if good.sum() < _FEWEST:
        raise ConfigError(f"{shown}: {good.sum()} of {len(t)} rows are usable; at least {_FEWEST} are needed")
    t = t[good] + source.time_offset - begin
    check_times(t, "time", shown)
    if t[-1] < 0.0 or t[0] > last:
        there = f"{t[0] + begin:.9g} to {t[-1] + begin:.9g} s"
        raise ConfigError(
            f"{shown}: its times, {there}, do not overlap with the IMU, {origin:.9g} to "
            f"{last + origin:.9g} s; [reference] time_offset_s is added to them"
        )
    q_b = rotation.conjugate(rotation.from_euler(*spec.mounting))
    track = _make_solution(t, lla[good], vel_n[good], rotation.multiply(q_nb[good], q_b), cov[good])
    reference = Reference(track, np.asarray(spec.point_b))
    if kind == NONE:
        return reference, checks
    reference, check = _align(kind, reference, fixes, antenna_b, shown)
    return reference, [*checks, check]


def _choose_alignment(spec: ReferenceSpec, placed: bool) -> str:
    """Return the alignment of local positions; raise ConfigError if they have no place without one."""
    kind = spec.align or (NONE if placed else YAW)
    if kind == NONE and not placed:
        text = "its local frame has no known place: set origin, or align = 'yaw' or 'se3'"
        raise ConfigError(f"{spec.source.path.name}: {text}")
    return kind


def _align(
    kind: str, reference: Reference, fixes: GnssFixes, antenna_b: FloatArray, shown: str
) -> tuple[Reference, Check]:
    """Return a reference moved and turned to the fixes, and the check with the alignment."""
    own = resample(take_as_read(reference.track, shown), fixes.t[fixes.valid])
    arm_n = np.nan_to_num(rotation.rotate(own.q_nb, antenna_b - reference.point_b))
    target = fixes.lla[fixes.valid]
    found = align(kind, displace(own.lla, arm_n), target, shown)
    check = Check("reference_alignment_m", found.residual, f"reference: {found}", True)
    return replace(reference, track=found.apply(reference.track)), check


def _read_rows(
    spec: ReferenceSpec, placing: Placing
) -> tuple[LogRows, FloatArray, FloatArray | None, bool | None]:
    """Return the rows of a file, attitude (N, 4), its sd (N, 3) if given, and the place as `place_rows`."""
    source, shown = spec.source, spec.source.path.name
    knows = find_format(source.format).knows
    if knows and source.topic is None and look(source.format, source.path).truth:
        return (*_read_truth(source), None)
    if source.format != "table":
        rows = formats.read(source.format, source.path, "gnss", source.topic)
        return rows, rows.values.get("q_nb", np.full((len(rows.t), 4), np.nan)), None, None
    optional = (*OPTIONAL, "attitude", "attitude sd", *(("position",) if spec.place else ()))
    table = read_table(source.path, _TABLE, optional, MOST_ROWS, source.columns, structure=source.topic)
    rows = LogRows.from_table(table, shown)
    placeless = "position" not in table.columns  # its attitude is evaluated, at the place of the log
    if placeless and "attitude" not in table.columns:
        raise ConfigError(f"{shown}: no columns for attitude (roll_deg, pitch_deg, heading_deg) or position")
    if placeless:
        rows = replace(rows, values={**rows.values, "lla": np.tile(spec.place or (), (len(rows.t), 1))})
    lla = rows.values.get("lla", np.zeros((len(rows.t), 3)))  # north of a local frame is north
    q_nb = np.full((len(lla), 4), np.nan)
    if "attitude" in table.columns:
        known = np.isfinite(lla).all(axis=1) & np.isfinite(table.columns["attitude"]).all(axis=1)
        given = {kind: table.columns[kind][known] for kind in ("position", "attitude") if kind in table.stems}
        q_en = rotation.from_matrix(matrix_en(*lla[known, :2].T))
        q_nb[known] = read_attitudes(table, given, q_en, np.flatnonzero(known) + 1, shown)
    if placeless and not np.isfinite(q_nb).all(axis=1).any():
        raise ConfigError(
            f"{shown}: no row has all angles ({', '.join(table.names['attitude'])}) as numbers; fill them in"
        )
    rows, placed = replace(rows, values={**rows.values, "q_nb": q_nb}), None
    if not placeless:
        rows, placed = place_rows(rows, table, placing, shown)
    return rows, rows.values["q_nb"], table.columns.get("attitude sd"), placed


def _read_truth(source: SourceSpec) -> tuple[LogRows, FloatArray, None]:
    """Return the truth of a simulator at the times of its positions."""
    own = read_truth(source)
    q_nb = np.full((len(own.t), 4), np.nan)
    if len(own.attitude_t):
        unknown = np.full((len(own.attitude_t), 3), np.nan)
        cov = np.zeros((len(own.attitude_t), 9, 9))
        attitude = _make_solution(own.attitude_t, unknown, unknown, own.q_nb, cov)
        q_nb = resample(take_as_read(attitude, source.path.name), own.t, NEAR).q_nb
    return LogRows(own.t, {"lla": own.lla, "vel_n": own.vel_n}), q_nb, None


def make_covariance(values: dict[str, FloatArray], sd_phi: FloatArray | None, n: int) -> FloatArray:
    """Return covariances (N, 9, 9); zero without a standard deviation, which counts as exact."""
    cov = np.zeros((n, 9, 9))
    for k, block in enumerate(("pos", "vel")):
        part = slice(3 * k, 3 * k + 3)
        if f"cov_{block}" in values:
            cov[:, part, part] = values[f"cov_{block}"].reshape(-1, 3, 3)
        elif f"sd_{block}" in values:
            cov[:, part, part] = np.square(np.maximum(values[f"sd_{block}"], 0.0))[:, :, None] * np.eye(3)
    if sd_phi is not None:
        cov[:, 6:, 6:] = np.square(np.maximum(sd_phi, 0.0))[:, :, None] * np.eye(3)
    return np.nan_to_num(cov)


def _make_solution(
    t: FloatArray, lla: FloatArray, vel_n: FloatArray, q_nb: FloatArray, cov: FloatArray
) -> NavSolution:
    unknown, none = np.full((len(t), 3), np.nan), np.empty((len(t), 0))
    return NavSolution(t, lla, vel_n, q_nb, unknown, unknown, cov, (), none, none)


def check_reference(reference: Reference, fixes: GnssFixes) -> Check:
    """Compare a reference with the fixes of the log; a large distance shows another drive or clock."""
    track = reference.track
    if not len(fixes) and not np.ptp(track.lla, axis=0).any():
        text = f"reference: {len(track)} rows, {track.t[0]:.2f} to {track.t[-1]:.2f} s, of one place"
        return Check("reference_to_fixes_m", None, text, True)
    blocks = {"velocity": track.vel_n, "attitude": track.q_nb}
    parts = ", ".join(["position", *(name for name, values in blocks.items() if np.isfinite(values).all())])
    sd = np.sqrt(np.median(np.einsum("kii->ki", track.cov)[:, :2].mean(axis=1)))
    exact = f"known to {sd:.3g} m" if sd > 0 else "taken as exact" if sd == 0 else "of unknown accuracy"
    text = f"reference: {len(track)} rows, {track.t[0]:.2f} to {track.t[-1]:.2f} s, {parts}, {exact}"
    order = np.argsort(fixes.t, kind="stable")
    near = fixes.take(order[fixes.valid[order]])
    own = resample(take_as_read(track, "reference"), near.t)
    known = np.isfinite(own.lla).all(axis=1) & np.isfinite(near.lla).all(axis=1)
    if not known.any():
        return Check("reference_to_fixes_m", None, f"{text}; no fix at its times to compare it with", True)
    off = np.hypot(*difference_n(own.lla[known], near.lla[known])[:, :2].T)
    spread = np.sqrt(np.einsum("kii->ki", near.cov_pos_n[known])[:, :2].sum(axis=1))
    distance, most = float(np.median(off)), max(_FAR, _SIGMAS * float(np.median(spread)))
    text += f"; {distance:.3g} m from the fixes in the median"
    if distance > most:
        text += ": is it of this drive, and time_offset_s of its clock?"
    return Check("reference_to_fixes_m", distance, text, distance <= most)
