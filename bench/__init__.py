"""bench: where an INS/GNSS navigation filter is judged on realistic flights.

JSBSim flies an aircraft through a profile and gives the truth; sensor models
turn truth into what an IMU, a GNSS receiver, a barometer and other instruments would
have reported; estimators turn the sensors into position, velocity, attitude and
covariance; the bench says how wrong they were and whether they knew it.

>>> import bench
>>> result = bench.run("figure-eight", seed=7)  # doctest: +SKIP
>>> result.metrics["loose-15"]["pos_rmse_h_m"]  # doctest: +SKIP

Conventions
-----------
Frames
    n local level at the current position (north, east, down), b body and IMU
    axes (forward, right, down), e Earth-fixed, i inertial.
Rotation
    ``C_ab`` and ``q_ab`` take a vector from b to a: ``v_a = C_ab @ v_b``. Inner
    letters cancel: ``C_eb = C_en @ C_nb``. Attitude is ``C_nb``, ``q_nb``.
    Quaternions are Hamilton, scalar first (w, x, y, z).
Vectors
    carry the frame last: ``vel_n``, ``f_b``. Rates carry all three: ``w_ib_b`` is
    the rate of b relative to i, resolved in b. Arrays are (N, 3), one instant
    per row.
Specific force
    is what an accelerometer reads: at rest ``f_b = -C_bn g_n``, so -9.8 m/s^2
    along down.
Euler angles
    are for people: roll, pitch, heading; yaw-pitch-roll sequence; heading from
    north, clockwise, [0, 2 pi).
Errors
    are estimate minus truth: ``pos_est = pos_true + pos_err``,
    ``C_nb_est = exp([phi_n x]) C_nb_true``. Feedback subtracts.
Units
    SI and radians inside. At the edges the name ends in the unit: ``lat_deg``,
    ``gyro_bias_deg_h``. A bare name is SI.
Time
    ``t`` in seconds since the start of the run. An interval's tag is its end.
Height
    is ellipsoidal unless the name says otherwise.
Noise
    ``_sd`` is a standard deviation, ``_psd`` a two-sided density: an angular
    random walk of N rad/sqrt(s) has ``gyro_psd = N**2`` in rad^2/s.
Randomness
    follows from (seed, run, name of the error term) alone.
"""

from __future__ import annotations

import sys
from importlib import import_module
from typing import Any

from bench.moved import MovedModules

__version__ = "0.1.0"

_PUBLIC = {
    "check": "bench.baselines.checking",
    "campaign": "bench.campaigns.running",
    "compare_cards": "bench.campaigns.card_comparison",
    "compare_results": "bench.baselines.comparing",
    "describe_flight": "bench.api",
    "export_run": "bench.api",
    "fly": "bench.api",
    "judge": "bench.api",
    "list_aircraft": "bench.config",
    "list_estimators": "bench.config",
    "list_exports": "bench.api",
    "list_legs": "bench.config",
    "list_profiles": "bench.config",
    "list_sensors": "bench.config",
    "load": "bench.store",
    "load_campaign": "bench.campaigns.stored",
    "load_profile": "bench.config",
    "load_study": "bench.studies.study_folder",
    "make_card": "bench.campaigns.card",
    "measure_allan": "bench.api",
    "navigate": "bench.api",
    "navigate_log": "bench.log_pipeline",
    "read_card": "bench.campaigns.card",
    "read_log": "bench.log_pipeline",
    "open_filter": "bench.api",
    "record_baselines": "bench.baselines.checking",
    "resume_filter": "bench.store.filter_state",
    "run": "bench.api",
    "save": "bench.saving",
    "save_filter": "bench.store.filter_state",
    "score_solution": "bench.api",
    "sense": "bench.api",
    "solve_rinex": "bench.api",
    "stream_run": "bench.api",
    "study": "bench.studies.conducting",
    "take_piece": "bench.navigation.engine.record_cuts",
    "to_arrow": "bench.store",
    "to_pandas": "bench.store",
    "plot_result": "bench.report.paper",
    "write_suite": "bench.campaigns.card",
    "write_figures": "bench.report.writing",
    "write_recording": "bench.recording",
    "write_report": "bench.report.writing",
    "check_estimator": "bench.navigation.estimator",
    "fix_steps": "bench.navigation.filter_adapters",
    "tune": "bench.campaigns.tuning",
    "track_solution": "bench.navigation.filter_adapters",
    "BenchError": "bench.errors",
    "ConfigError": "bench.errors",
    "EstimatorError": "bench.errors",
    "FlightError": "bench.errors",
    "Guard": "bench.specs",
}

__all__ = ["__version__", *_PUBLIC]

sys.meta_path.append(MovedModules())


def __getattr__(name: str) -> Any:
    if name in _PUBLIC:
        return getattr(import_module(_PUBLIC[name]), name)
    raise AttributeError(f"module 'bench' has no attribute {name!r}")


def __dir__() -> list[str]:
    return sorted(__all__)
