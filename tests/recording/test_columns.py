"""What a recording holds is what the Parquet files of its folder hold: every entity, read back."""

from __future__ import annotations

import re
import subprocess
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
import rerun_cli
from numpy.testing import assert_allclose
from rerun.chunk import RrdReader

import bench
from bench.core.mathematics import earth, rotation
from bench.evaluation.consistency.chi_square import chi2_quantile
from bench.views.recording.drawing import TIMELINE

DURATION = 30.0
CHANGES = {
    "duration_s": DURATION,
    "evaluation.from_s": 5.0,
    "leg": [{"kind": "straight", "duration_s": 12.0}, {"kind": "turn", "by_deg": 90.0, "bank_deg": 20.0}],
    "gnss_outage": [{"start_s": 10.0, "duration_s": 5.0}],
    "fault": [{"kind": "baro-step", "start_s": 20.0, "duration_s": 3.0, "step_m": 30.0}],
}
DERIVED = {"/sky/antenna"}
"""Entities without a column: the edge of the antenna in the sky follows the attitude."""
AXES_N, AXES_B = ("north", "east", "down"), ("x", "y", "z")
SCALE = {"pos": 1.0, "vel": 1.0, "phi": 180.0 / np.pi}
DEG_H, MG = 3600.0 * 180.0 / np.pi, 1e3 / 9.80665


@pytest.fixture(scope="module")
def profile():
    return bench.read_profile("all-sensors", CHANGES, estimators=["loose-full", "free-inertial"])


@pytest.fixture(scope="module")
def folder(profile, tmp_path_factory) -> Path:
    return bench.write_result(bench.run(profile), tmp_path_factory.mktemp("columns") / "run", report=False)


@pytest.fixture(scope="module")
def recorded(folder):
    """Times, and the rows of each component, of every entity that changes."""
    found: dict[str, dict[str, list]] = {}
    for chunk in RrdReader(folder / "flight.rrd").stream():
        batch = chunk.to_record_batch()
        if not chunk.is_static:
            one = found.setdefault(chunk.entity_path, {"t": []})
            one["t"] += (batch.column(TIMELINE).cast(pa.int64()).to_numpy() * 1e-9).tolist()
            for name in batch.schema.names:
                if ":" in name:
                    one.setdefault(name.partition(":")[2], []).extend(batch.column(name).to_pylist())
    return found


class Tables:
    """The Parquet files of a folder, column by column."""

    def __init__(self, folder: Path):
        self.folder, self.read = folder, {}

    def __call__(self, name: str) -> dict[str, np.ndarray]:
        if name not in self.read:
            table = pq.read_table(self.folder / f"{name}.parquet")
            self.read[name] = {key: table.column(key).to_numpy() for key in table.column_names}
        return self.read[name]

    def stack(self, name: str, *columns: str) -> np.ndarray:
        return np.column_stack([self(name)[column] for column in columns])

    def lla(self, name: str) -> np.ndarray:
        return self.stack(name, "lat_rad", "lon_rad", "alt_m")

    def events(self, *names: str) -> list[tuple[float, float, str, str]]:
        columns = ("t_s", "t_end_s", "kind", "text")
        rows = [zip(*(self(name)[column] for column in columns), strict=True) for name in names]
        return sorted(row for part in rows for row in part)


@pytest.fixture(scope="module")
def tables(folder):
    return Tables(folder)


def check(one: dict, component: str, t, values, rtol=1e-12, atol=0.0) -> None:
    """Compare rows with those of a table at the same times, and see that no more than thinning is missing."""
    shown, t, values = np.array(one["t"]), np.asarray(t), np.asarray(values, float)
    width = values[0].size
    rows = np.array(
        [np.ravel(row) if row is not None and len(row) else np.full(width, np.nan) for row in one[component]]
    )
    at = np.clip(np.searchsorted(t, shown - 1e-6), 0, len(t) - 1)
    assert_allclose(t[at], shown, rtol=0, atol=2e-9)  # rerun counts nanoseconds
    assert_allclose(rows, values[at].reshape(len(at), -1), rtol=rtol, atol=atol)
    assert len(shown) >= 0.9 * min(len(t), DURATION)


# --- one rule for each kind of entity --------------------------------------------------------------------


def check_comparison(tables, one, log, what, label):
    errors = tables(f"errors-{label}")
    size = {
        "horizontal": np.hypot(errors["pos_err_n_m"], errors["pos_err_e_m"]),
        "vertical": errors["pos_err_d_m"],
        "velocity": np.linalg.norm([errors[f"vel_err_{k}_mps"] for k in "ned"], axis=0),
        "heading": np.rad2deg(errors["heading_err_rad"]),
    }[what]
    check(one, "scalars", errors["t_s"], np.log10(np.maximum(np.abs(size), 1e-3)) if log else size)


def check_error(tables, one, label, what, axis):
    block = {"position": "pos", "velocity": "vel", "attitude": "phi"}[what]
    k, errors, solution = AXES_N.index(axis), tables(f"errors-{label}"), tables(f"solution-{label}")
    name = {"pos": "pos_err_{}_m", "vel": "vel_err_{}_mps", "phi": "phi_{}_rad"}[block].format("ned"[k])
    column = f"cov_{block}_{'ned'[k]}_{block}_{'ned'[k]}"
    three = 3.0 * np.sqrt(solution[column])[np.searchsorted(solution["t_s"], errors["t_s"])]
    check(
        one,
        "scalars",
        errors["t_s"],
        SCALE[block] * np.column_stack([errors[name], three, -three]),
        rtol=1e-9,
    )


def check_bias(tables, one, label, name, which):
    unit, scale = {"gyro": ("_rad_s", DEG_H), "acce": ("_m_s2", MG), "baro": ("_m", 1.0)}[name[:4]]
    if which == "true":
        drawn = tables("sensors-drawn")
        check(one, "scalars", drawn["t_s"], scale * drawn[name + unit])
        return
    solution = tables(f"solution-{label}")
    value, sd = (scale * solution[f"{kind}_{name}{unit}"] for kind in ("state", "sd"))
    if name[:4] in ("gyro", "acce"):
        value = scale * solution[name + unit]
    check(
        one, "scalars", solution["t_s"], np.column_stack([value, value + 3 * sd, value - 3 * sd]), rtol=1e-9
    )


def check_innovation(tables, one, label, sensor, axis, which):
    table = tables(f"innovations-{label}")
    here = (table["sensor"] == sensor) & (
        table["component"] == (0 if axis == "value" else AXES_N.index(axis))
    )
    if which == "bounds":
        t, three = table["t_s"][here], 3.0 * np.sqrt(table["S"][here])
        empty = [k for k, row in enumerate(one["scalars"]) if row is None or not len(row)]
        assert len(empty) <= 1  # in the middle of the outage
        for k in empty:
            after = int(np.searchsorted(t, one["t"][k]))
            assert t[after] - t[after - 1] > 5.0 * np.median(np.diff(t))
        drawn = {name: [v for k, v in enumerate(one[name]) if k not in empty] for name in ("t", "scalars")}
        check(drawn, "scalars", t, np.column_stack([three, -three]))
        return
    here &= table["accepted"] == (which == "used")
    assert here.sum() == len(one["t"])
    check(one, "scalars", table["t_s"][here], table["z"][here])


def check_squares(tables, one, label, kind, which):
    if kind == "nees":
        errors = tables(f"errors-{label}")
        t, values, states = errors["t_s"], errors["nees"], 9
    else:
        table = tables(f"innovations-{label}")
        sensor = kind.removeprefix("nis/")
        here = table["sensor"] == sensor
        states = int(table["component"][here].max()) + 1
        here &= table["component"] == 0
        t, values = table["t_s"][here], table["nis"][here]
    if which == "band":
        edges = [chi2_quantile(0.025, states), chi2_quantile(0.975, states)]
        assert_allclose(one["scalars"], [edges, edges])
        assert_allclose(one["t"], t[[0, -1]], atol=2e-9)
    else:
        check(one, "scalars", t, values)


FLIGHT = {
    "altitude/true": ("truth", "alt_m", 1.0),
    "altitude/gnss": ("sensors-gnss", "alt_m", 1.0),
    "altitude/baro": ("sensors-baro", "alt_baro_m", 1.0),
    "speed/airspeed": ("sensors-airspeed", "airspeed_true_mps", 1.0),
    "speed/true_airspeed": ("truth-air", "airspeed_true_mps", 1.0),
    "speed/calibrated_airspeed": ("truth-air", "airspeed_calibrated_mps", 1.0),
    "air_angles/alpha": ("truth-air", "alpha_rad", 180.0 / np.pi),
    "air_angles/beta": ("truth-air", "beta_rad", 180.0 / np.pi),
    "engine/speed": ("truth-air", "engine_speed_rad_s", 30.0 / np.pi),
    "throttle/throttle": ("truth-controls", "throttle", 100.0),
    **{f"surfaces/{name}": ("truth-controls", name, 1.0) for name in ("aileron", "elevator", "rudder")},
    **{f"wind/{axis}": ("truth-air", f"wind_{axis[0]}_mps", 1.0) for axis in AXES_N},
    **{f"magnetic_field/{axis}": ("sensors-mag", f"field_{k}_t", 1e6)
       for axis, k in zip(("forward", "right", "down"), AXES_B, strict=True)},
}  # fmt: skip


def check_flight(tables, one, line):
    if line in FLIGHT:
        name, column, scale = FLIGHT[line]
        check(one, "scalars", tables(name)["t_s"], scale * tables(name)[column])
        return
    truth, q_nb = tables("truth"), tables.stack("truth", "q_nb_w", "q_nb_x", "q_nb_y", "q_nb_z")
    roll, pitch, heading = np.rad2deg(rotation.to_euler(q_nb))
    speed = np.hypot(truth["vel_n_mps"], truth["vel_e_mps"])
    values = {"ground_speed": speed, "roll": roll, "pitch": pitch, "heading": heading}
    check(one, "scalars", truth["t_s"], values[line.partition("/")[2]], rtol=1e-9, atol=1e-12)


def check_pose(tables, one, entity):
    name = "truth" if entity == "truth" else entity.replace("estimators/", "solution-")
    table, lla = tables(name), tables.lla(name)
    origin = tables.lla("truth")[0]
    C_es, C_en = (earth.matrix_en(point[..., 0], point[..., 1]) for point in (origin, lla))
    q_nb = tables.stack(name, "q_nb_w", "q_nb_x", "q_nb_y", "q_nb_z")
    C_sb = C_es.T @ C_en @ rotation.matrix(q_nb)
    check(one, "translation", table["t_s"], earth.local_ned(lla, origin), rtol=1e-6, atol=1e-3)
    q_sb = np.array(one["quaternion"], float).reshape(-1, 4)[:, [3, 0, 1, 2]]
    turned = {"t": one["t"], "C": rotation.matrix(q_sb).reshape(-1, 9)}
    check(turned, "C", table["t_s"], C_sb.reshape(-1, 9), rtol=0, atol=3e-6)


def check_ellipsoid(tables, one, label):
    name = f"solution-{label}"
    origin, rows = tables.lla("truth")[0], [[f"cov_pos_{a}_pos_{b}" for b in "ned"] for a in "ned"]
    cov = np.stack([tables.stack(name, *row) for row in rows], axis=1)
    check(
        one, "centers", tables(name)["t_s"], earth.local_ned(tables.lla(name), origin), rtol=1e-6, atol=1e-3
    )
    half = np.array(one["half_sizes"], float).reshape(-1, 3)
    axes = rotation.matrix(np.array(one["quaternions"], float).reshape(-1, 4)[:, [3, 0, 1, 2]])
    found = np.einsum("kij,kj,klj->kil", axes, (half / 3.0) ** 2, axes)
    again = {"t": one["t"], "cov": found.reshape(len(found), 9)}
    check(again, "cov", tables(name)["t_s"], cov.reshape(len(cov), 9), rtol=1e-4, atol=1e-4)


def check_fixes(tables, one, root):
    fixes, lla = tables("sensors-gnss"), tables.lla("sensors-gnss")
    assert len(one["t"]) == fixes["valid"].sum()
    if root == "map":
        check(one, "positions", fixes["t_s"], np.rad2deg(lla[:, :2]))
    else:
        check(
            one, "positions", fixes["t_s"], earth.local_ned(lla, tables.lla("truth")[0]), rtol=1e-6, atol=1e-3
        )


def check_map(tables, one):
    check(one, "positions", tables("truth")["t_s"], np.rad2deg(tables.lla("truth")[:, :2]))


def check_wind(tables, one):
    air = tables("truth-air")
    wind = tables.stack("truth-air", "wind_n_mps", "wind_e_mps", "wind_d_mps")
    vectors = np.array(one["vectors"], float).reshape(-1, 3)
    long = np.linalg.norm(vectors[0]) / np.linalg.norm(wind[0])
    check(one, "vectors", air["t_s"], long * wind, rtol=1e-5, atol=1e-5)
    ned = earth.local_ned(tables.lla("truth"), tables.lla("truth")[0])
    check(one, "origins", tables("truth")["t_s"], ned, rtol=1e-6, atol=1e-3)


def check_satellites(tables, one, plot, line):
    sky = tables("sensors-sky")
    t, epoch = np.unique(sky["t_s"], return_inverse=True)
    if plot.startswith("cn0"):
        system, sat = "GR".index(line[0]), int(line[1:])
        mine, values = (sky["system"] == system) & (sky["sat"] == sat), np.full(len(t), np.nan)
        values[epoch[mine]] = sky["cn0_dbhz"][mine]
    elif plot == "number":
        values = np.bincount(epoch, sky["used"] if line == "used" else None).astype(float)
    else:
        values = np.full((len(t), 3), np.nan)
        for k in range(len(t)):
            rows = np.flatnonzero((epoch == k) & sky["used"])
            el, az, system = (sky[name][rows] for name in ("elevation_rad", "azimuth_rad", "system"))
            parts = [np.cos(el) * np.cos(az), np.cos(el) * np.sin(az), -np.sin(el), system == 0, system == 1]
            G = np.column_stack([part.astype(float) for part in parts])
            G = G[:, np.abs(G).max(axis=0, initial=0.0) > 0.0]
            if len(G) >= G.shape[1] > 3:
                n, e, d = np.diag(np.linalg.inv(G.T @ G))[:3]
                values[k] = np.sqrt([n + e + d, n + e, d])
    check(one, "scalars", t, values, rtol=1e-9)


def check_sky(tables, one):
    sky = tables("sensors-sky")
    start = tables("truth")["t_s"][0]
    first, *_ = np.unique(sky["t_s"])
    for shown, positions in zip(one["t"], one["positions"], strict=True):
        rows = np.abs(sky["t_s"] - (first if shown == start else shown)) < 1e-6
        away = 1.0 - sky["elevation_rad"][rows] / (0.5 * np.pi)
        place = np.column_stack([np.sin(sky["azimuth_rad"][rows]), -np.cos(sky["azimuth_rad"][rows])])
        assert_allclose(positions, away[:, None] * place, atol=1e-6)


def check_events(tables, one):
    labels = ("loose-full", "free-inertial")
    rows = tables.events("truth-events", "sensors-events", *(f"events-{label}" for label in labels))
    assert_allclose(one["t"], [row[0] for row in rows], atol=2e-9)
    told = " ".join(text for (text,) in one["text"])
    assert all(text in told for *_, text in rows)


def check_phase(tables, one, what):
    legs = [(start, text) for start, _, kind, text in tables.events("truth-events") if kind == "leg"]
    ends = {kind: (start, end) for start, end, kind, _ in tables.events("sensors-events")}
    lost, struck = ends["gnss_outage"], ends["fault"]
    expected = {
        "leg": legs,
        "gnss": [(0.0, "available"), (lost[0], "outage"), (lost[1], "available")],
        "faults": [(0.0, "none"), (struck[0], "baro-step of baro"), (struck[1], "none")],
    }[what]
    assert_allclose(one["t"], [*(t for t, _ in expected), DURATION], atol=0.01)
    assert [state for (state,) in one["state"]] == [*(text for _, text in expected), ""]


def check_behind(tables, one, key):
    kind = {"outage": "gnss_outage", "fault": "fault"}[key]
    ((start, end, *_),) = (row for row in tables.events("sensors-events") if row[2] == kind)
    drawn = [t for t, row in zip(one["t"], one["scalars"], strict=True) if row]
    assert (drawn[0], drawn[-1]) == pytest.approx((start, end))


RULES = (
    (r".*/behind/(\w+)", check_behind),
    (r"/comparison(-log)?/(\w+)/(.+)", check_comparison),
    (r"/estimators/([\w-]+)/(position|velocity|attitude)/(\w+)/error", check_error),
    (r"/estimators/([\w-]+)/bias/(\w+)/(\w+)", check_bias),
    (r"/estimators/([\w-]+)/innovation/(\w+)/(\w+)/(\w+)", check_innovation),
    (r"/estimators/([\w-]+)/(nees|nis/\w+)/(\w+)", check_squares),
    (r"/flight/(\w+/\w+)", check_flight),
    (r"/world/(truth|estimators/[\w-]+)/aircraft", check_pose),
    (r"/world/estimators/([\w-]+)/ellipsoid", check_ellipsoid),
    (r"/(world|map)/gnss/fixes", check_fixes),
    (r"/map/truth/aircraft", check_map),
    (r"/world/wind", check_wind),
    (r"/satellites/(cn0/\w+|number|dop)/(\w+)", check_satellites),
    (r"/sky/satellites", check_sky),
    (r"/events", check_events),
    (r"/phase/(\w+)", check_phase),
)  # fmt: skip


def test_every_entity_holds_its_columns(recorded, tables):
    checked = dict.fromkeys(rule for _, rule in RULES)
    for entity, one in recorded.items():
        if entity in DERIVED:
            continue
        for pattern, rule in RULES:
            if found := re.fullmatch(pattern, entity):
                rule(tables, one, *found.groups())
                checked[rule] = entity
                break
        else:
            pytest.fail(f"{entity} is compared with no column")
    assert None not in checked.values()


def test_recordings_of_equal_runs_hold_equal_entities_times_and_values(profile, folder, tmp_path):
    again = bench.write_result(bench.run(profile), tmp_path / "again", report=False)
    tool = Path(rerun_cli.__file__).parent / "rerun"
    both = (folder / "flight.rrd", again / "flight.rrd")
    done = subprocess.run([tool, "rrd", "compare", *both], capture_output=True, text=True, timeout=60)
    assert done.returncode == 0, done.stderr
