"""bench: where an INS/GNSS navigation filter is evaluated on realistic flights.

JSBSim flies an aircraft through a profile and gives the truth; sensor models
turn truth into what an IMU, a GNSS receiver, a barometer and other instruments would
have reported; filters turn the sensors into position, velocity, attitude and
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
    the rate of b relative to i, resolved in b. Arrays are (N, 3), one time
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

from importlib import import_module
from typing import TYPE_CHECKING, Any

__version__ = "0.1.0"

if TYPE_CHECKING:
    from bench.cli.api import (
        fly as fly,
        evaluate as evaluate,
        run_filter as run_filter,
        open_filter as open_filter,
        run as run,
        sense as sense,
    )
    from bench.cli.exchanging import (
        convert_unit as convert_unit,
        export_run as export_run,
        measure_allan as measure_allan,
        score_solution as score_solution,
        stream_run as stream_run,
    )
    from bench.cli.listings import list_metrics as list_metrics, list_studies as list_studies
    from bench.plugins.receiver.receiver_settings import solve_rinex as solve_rinex
    from bench.experiments.baselines.checking import check as check
    from bench.experiments.baselines.comparing import compare_results as compare_results
    from bench.experiments.card.card_making import (
        make_card as make_card,
        read_card as read_card,
    )
    from bench.experiments.card.card_comparison import compare_cards as compare_cards
    from bench.experiments.campaigns.running import campaign as campaign
    from bench.experiments.campaigns.stored import read_campaign as read_campaign
    from bench.experiments.tuning.noise_factors import tune as tune
    from bench.io.config import (
        list_aircraft as list_aircraft,
        list_estimators as list_estimators,
        list_profiles as list_profiles,
        list_sensors as list_sensors,
        read_profile as read_profile,
    )
    from bench.core.records.data import (
        InitialState as InitialState,
        NavSolution as NavSolution,
        SensorData as SensorData,
        Trajectory as Trajectory,
    )
    from bench.core.records.run_records import Sensed as Sensed
    from bench.core.words.exceptions import (
        BenchError as BenchError,
        ConfigError as ConfigError,
        EstimatorError as EstimatorError,
        FlightError as FlightError,
    )
    from bench.pipeline.log_pipeline import navigate as navigate, read_log as read_log
    from bench.navigation.engine.record_cuts import slice_sensors as slice_sensors
    from bench.navigation.estimator import Estimator as Estimator, check_estimator as check_estimator
    from bench.navigation.filter_adapters import fix_steps as fix_steps, track_solution as track_solution
    from bench.views.report.writing import write_report as write_report
    from bench.core.records.run_result import RunResult as RunResult
    from bench.cli.saving import write_result as write_result
    from bench.plugins.hil.serving import serve as serve
    from bench.core.records.specs import Guard as Guard, Profile as Profile
    from bench.io.results import read_result as read_result, to_arrow as to_arrow
    from bench.io.results.filter_state import read_filter as read_filter, write_filter as write_filter
    from bench.experiments.studies.conducting import study as study
    from bench.io.results.study_folder import read_study as read_study

_PUBLIC = {
    "campaign": "bench.experiments.campaigns.running",
    "check": "bench.experiments.baselines.checking",
    "check_estimator": "bench.navigation.estimator",
    "compare_cards": "bench.experiments.card.card_comparison",
    "compare_results": "bench.experiments.baselines.comparing",
    "convert_unit": "bench.cli.exchanging",
    "export_run": "bench.cli.exchanging",
    "fix_steps": "bench.navigation.filter_adapters",
    "fly": "bench.cli.api",
    "evaluate": "bench.cli.api",
    "list_aircraft": "bench.io.config",
    "list_estimators": "bench.io.config",
    "list_metrics": "bench.cli.listings",
    "list_profiles": "bench.io.config",
    "list_sensors": "bench.io.config",
    "list_studies": "bench.cli.listings",
    "read_result": "bench.io.results",
    "read_campaign": "bench.experiments.campaigns.stored",
    "read_profile": "bench.io.config",
    "read_study": "bench.io.results.study_folder",
    "make_card": "bench.experiments.card.card_making",
    "measure_allan": "bench.cli.exchanging",
    "navigate": "bench.pipeline.log_pipeline",
    "run_filter": "bench.cli.api",
    "open_filter": "bench.cli.api",
    "read_card": "bench.experiments.card.card_making",
    "read_log": "bench.pipeline.log_pipeline",
    "read_filter": "bench.io.results.filter_state",
    "run": "bench.cli.api",
    "write_result": "bench.cli.saving",
    "write_filter": "bench.io.results.filter_state",
    "score_solution": "bench.cli.exchanging",
    "sense": "bench.cli.api",
    "stream_run": "bench.cli.exchanging",
    "study": "bench.experiments.studies.conducting",
    "slice_sensors": "bench.navigation.engine.record_cuts",
    "to_arrow": "bench.io.results",
    "track_solution": "bench.navigation.filter_adapters",
    "tune": "bench.experiments.tuning.noise_factors",
    "write_report": "bench.views.report.writing",
    "BenchError": "bench.core.words.exceptions",
    "ConfigError": "bench.core.words.exceptions",
    "Estimator": "bench.navigation.estimator",
    "EstimatorError": "bench.core.words.exceptions",
    "FlightError": "bench.core.words.exceptions",
    "Guard": "bench.core.records.specs",
    "InitialState": "bench.core.records.data",
    "NavSolution": "bench.core.records.data",
    "Profile": "bench.core.records.specs",
    "RunResult": "bench.core.records.run_result",
    "Sensed": "bench.core.records.run_records",
    "SensorData": "bench.core.records.data",
    "Trajectory": "bench.core.records.data",
}

_OF_PLUGINS = {"serve": "serve", "solve_rinex": "fixes"}
"""Name -> a verb of the plug-in that holds it; the ``PUBLIC`` of the verb's module says where."""

__all__ = ["__version__", *_PUBLIC, *_OF_PLUGINS]

if not TYPE_CHECKING:  # a checker of types sees the imports above, and no name that is not there

    def __getattr__(name: str) -> Any:
        if name in _PUBLIC:
            import_module("bench.views")  # so that results can draw themselves
            return getattr(import_module(_PUBLIC[name]), name)
        if name in _OF_PLUGINS:
            from bench.core.files.installed import find_own, read_constant

            verb = find_own("verbs")[_OF_PLUGINS[name]].partition(":")[0]
            return getattr(import_module(read_constant(verb, "PUBLIC")), name)
        raise AttributeError(f"module 'bench' has no attribute {name!r}")


def __dir__() -> list[str]:
    return sorted(__all__)
