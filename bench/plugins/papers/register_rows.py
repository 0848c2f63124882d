"""The rows of the coverage table (equations 9): printed formula, required result, and proof.

A row that takes seconds has a function; every row that is not open names a test.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import NamedTuple

from bench.plugins.papers import register_flights as flights
from bench.plugins.papers import register_linear as linear
from bench.plugins.papers import register_measures as measure
from bench.plugins.papers.register_measures import RowFinding


class Row(NamedTuple):
    """A capability of the sources."""

    number: int
    what: str
    source: str
    printed: str
    """In the source: its equation or number; "" if right or silent."""
    required: str
    """What must be found."""
    test: str = ""
    """``path::name`` of the test that proves it; "": open."""
    measure: Callable[[], RowFinding] | None = None
    open_because: str = ""
    """Why nothing proves it; for a row without a test."""


_MECH = "tests/plugins/papers/test_mechanizations.py::test_"
_REG = "tests/plugins/papers/test_register.py::test_"
_SQUARES = "tests/signals/test_least_squares.py::test_"
_COSTS = "tests/plugins/papers/test_mechanizations_study.py::test_"
_TERMS = "tests/sensors/test_imu_terms.py::test_"
_FIXES = "tests/navigation/test_gnss_only.py::test_"
_TRUTH = "tests/flight/test_recorder.py::test_"

ROWS: tuple[Row, ...] = (
    Row(1, "NHE mechanization", "A-2.2.2", "V x w: 1.8 km in 300 s",
        "w x V: at rest 1 h < 0.01 m; ENU < 1e-6 m/s",
        _MECH + "1_an_hour_at_rest_is_below_a_centimeter", measure.rest_for_an_hour),
    Row(2, "ENU mechanization", "A-5.1.4", "g_T = +mu/a^2: 5.6 mg", "ECEF differentiation within 1e-9 m/s^2",
        _MECH + "2_coriolis_and_transport_are_those_of_the_earth_fixed_frame"),
    Row(3, "inertial frame", "A-2.2", "", "ENU within 0.01 m after 600 s",
        _MECH + "3_the_inertial_frame_is_enu_over_600_s", measure.fly_inertial),
    Row(4, "three rates", "A-2.2.6", "", "100/50/10 Hz <= 0.4 m in 300 s", _MECH + "4_three_rates",
        measure.fly_three_rates),
    Row(5, "direction cosines", "A-2.2.P", "b13 of A-2.2.8: det 0.926", 'det 1: <= 0.02" after 300 s',
        _MECH + "5_to_8_attitude_after_300_s", partial(measure.fly_attitude, "poisson", 0.02)),
    Row(6, "Euler angles", "A-2.2.7", "no limit at 90 deg", '<= 0.02"; diverge at 90 deg',
        _MECH + "6_euler_angles_diverge_at_the_vertical_and_their_guard_holds",
        measure.fly_euler),
    Row(7, "quaternion to NHE", "A-2.2.4", "signs: d|q|^2/dt = 0.12 1/s", '0: <= 0.2" after 300 s',
        _MECH + "5_to_8_attitude_after_300_s", partial(measure.fly_attitude, "quaternion", 0.2)),
    Row(8, "two quaternions, Picard", "A-2.2.5", "e/.8: 0.036 rad at 1 deg", "cube / 24 +- 2 %; 1.99e-4 rad",
        _MECH + "8_two_quaternions_lose_2e_4_rad_in_600_s", measure.take_picard_step),
    Row(9, "comparison of attitudes", "A-2.2", "", "coning 9.60, 2.72; 2.55, 0.196; 0.65, 0.013 deg/h",
        _MECH + "9_coning_drifts", measure.cone),
    Row(10, "series of radii and gravity", "A-2.2.1", "-e^2: -1.34 %; 3/2 q: 3.5 mg",
        "0.3 ppm, 45 ppm; 0.33 ug, 15 to 21 ug", _MECH + "10_series_of_the_radii", measure.expand_series),
    Row(11, "ellipsoids", "A-2.2.R", "a of Hayford, e^2 = 2f", "identities of R_M, R_P",
        _MECH + "11_every_ellipsoid_is_flown", measure.measure_ellipsoids),
    Row(12, "accelerometers alone", "A-2.3", "", "error ~ t^2 of level and Schuler's term",
        _COSTS + "12_the_strapdown_follows_the_law_of_accelerometers_alone",
        measure.drift_without_gyros),
    Row(13, "sensor errors", "A-2.4.S", "", "Allan level 5 %; scale factor, misalignment 1 %",
        "tests/sensors/test_imu.py::test_white_noise_has_the_allan_deviation_of_the_datasheet"),
    Row(14, "g-dependent drift", "A-T2.4.2", '"deg/h"', "tumble: twice the deg/h/g +- 1 %",
        _TERMS + "a_tumble_gives_the_g_sensitivity_back"),
    Row(15, "three grades", "A-T2.4.1", "units", "SI: grade 3 ARW 2.909e-6 rad/sqrt(s)",
        "tests/config/test_catalog.py::test_the_grades_of_the_source_are_read_as_the_register_reads_them"),
    Row(16, "requirement for 5 m", "A-2.4.7", "", "300 s: 11.46 ug, 0.02353 deg/h",
        "tests/studies/test_requirements.py::test_16_the_closed_form_is_the_table_of_the_register",
        measure.require),
    Row(17, "error budget", "A-3", "", "superposition within 3 %",
        "tests/evaluation/linear/test_linear_budget.py::test_single_runs_add_up_to_the_full_run"),
    Row(18, "15-state error equations", "A-5.1.10", "9 misprints: -102 m",
        "F = Jacobian 1e-4; < 0.05 m in 1200 s",
        _REG + "18_f_is_the_jacobian_of_the_mechanization"),
    Row(19, "three attitude errors", "A-5.1.12", "signs: 3.7e-4 rad", "1e-15 rad after 5000 s",
        _REG + "19_three_attitude_parametrizations_are_one",
        measure.describe_attitude_error),
    Row(20, "discretization", "A-5.1.D", "G dt: 10x", "G sqrt(dt): sigma within 1 % over dt",
        _REG + "20_sigmas_do_not_depend_on_the_step",
        linear.keep_step),
    Row(21, "Markov errors of GNSS", "A-5.2.2", "", "sd 3 %; 667 s, 2000 s",
        "tests/sensors/test_gnss.py::test_markov_error_forgets_by_distance_and_time"),
    Row(22, "jumps with the constellation", "A-5.2.1", "sigma of height", "RMS 5 % over 1000",
        "tests/sensors/test_gnss.py::test_jumps_at_constellation_changes_have_their_rms"),
    Row(23, "ranges of parameters", "A-5.2", "0.05 to 0.02 m", "presets",
        "tests/sensors/test_gnss.py::test_presets_are_the_ends_and_the_middle_of_the_source"),
    Row(24, "barometer", "A-5.3", "", "sd after 1 h within 5 %",
        "tests/sensors/test_baro.py::test_bias_after_an_hour"),
    Row(25, "constellations", "A-2.1.2", "h = 20146 km", "DOP table within 0.05",
        "tests/signals/test_orbits.py::test_dop_table_of_the_nominal_constellations"),
    Row(26, "DOP", "A-2.1.3", "c pdt", "RMS / (sigma PDOP) = 1 +- 0.03",
        _SQUARES + "rms_error_is_sd_times_pdop"),
    Row(27, "expected accuracy", "A-2.1", "", "95 % containment 93 to 97 %",
        "tests/navigation/test_layouts.py::test_loose_22_keeps_all_three_claims_on_matched_sensors"),
    Row(28, "choice of constellation", "A-2.1", "", "brute force over 24 h",
        _SQUARES + "the_best_set_is_that_of_brute_force"),
    Row(29, "output datum", "A-2.1", "", "156.3 m; round trip < 1e-3 m; PROJ 1 cm",
        "tests/exchange/test_datums.py::test_sk42_equals_proj", measure.shift_datum),
    Row(30, "antenna switching", "A-2.1", "", "no innovation step > 3 sigma",
        "tests/plugins/papers/test_antenna_switching.py::test_30_no_innovation_steps_where_the_antenna_changes",
        flights.switch_antenna),
    Row(31, "acceleration steps", "A-2.1", "", "NIS in bounds through 2 g",
        "tests/plugins/papers/test_acceleration_step.py::test_31_nis_stays_in_its_band_through_a_step_of_2_g",
        flights.step_of_2_g),
    Row(32, "GNSS error sources", "A-2.1.7", "", "RMS of each 5 %",
        "tests/sensors/test_sky.py::test_each_range_error_has_its_size"),
    Row(33, "availability, integrity, continuity", "A-2.1.5", "probability", "risk, with bounds",
        "tests/studies/test_rnp.py::test_a_satellite_that_creeps_away_is_followed_by_its_own_state",
        flights.require_performance),
    Row(34, "22-state filter", "A-5.4", "28 noises, 34 columns", "NIS 7 +- 0.1, NEES 22 +- 1.5",
        _REG + "34_a_linear_flight_is_consistent",
        linear.be_consistent),
    Row(35, "8 measurements", "A-5.4.3", "8", "rank 7; pseudo-inverse = 7 rows",
        _REG + "35_the_published_eight_rows_have_rank_seven",
        linear.count_rank),
    Row(36, "Joseph form", "A-5.4.5", "", "P > 0 after 1e5 updates",
        _REG + "36_josephs_form_stays_positive_over_1e5_updates"),
    Row(37, "Potter, Carlson", "A-3", "", "Joseph 1e-9; float32 stays positive",
        "tests/plugins/papers/test_filter_methods.py::test_37_square_root_forms_are_josephs"),
    Row(38, "other methods", "A-4", "", "RMS(Kalman) <= RMS(each)",
        "tests/plugins/papers/test_filter_methods.py::test_38_the_kalman_filter_is_no_worse_than_the_other_methods"),
    Row(39, "covariance floor", "A-5.4.F", "", "P_ii >= gamma_i; faster after a step",
        _REG + "39_no_variance_falls_below_the_floor"),
    Row(40, "tolerance test", "A-5.4.T", "no formula", "100 m at the first epoch",
        _REG + "40_a_step_of_100_m_is_refused_at_the_first_epoch"),
    Row(41, "innovation test", "A-5.4.7", "trace ratio sees 8 sigma in 0.2 %", "NIS in 99.98 %",
        _REG + "41_the_table_of_trace_ratio_and_nis", measure.detect),
    Row(42, "baro-GNSS check", "A-5.4.3", "", "monitor at 5 sigma",
        _REG + "42_barometer_and_gnss_watch_each_other"),
    Row(43, "correction period", "A-5.4.10", "327 s, without the start", "172.2 s",
        _REG + "43_the_table_of_correction_periods", measure.correct),
    Row(44, "feedback or open loop", "A-5.4", "", "equal to 1e-6 while small",
        _REG + "44_feedback_and_open_loop_are_one_while_errors_are_small"),
    Row(45, "calibration kept", "A-5.4.11", "", "within 3 sigma; drift / 10",
        _REG + "45_the_calibration_is_kept_and_applied"),
    Row(46, "extrapolated calibration", "A-2.3", "", "outage error < 0.3 of the INS at 60 s",
        "tests/plugins/papers/test_second_source.py::test_46_a_curve_through_the_errors_goes_on_through_an_outage",
        linear.go_on),
    Row(47, "outages", "A-3", "", "equations 7.1 within 15 %",
        "tests/studies/test_linear_flight.py::test_47_71_the_covariance_table",
        linear.grow),
    Row(48, "between fixes", "A-1", "", "< 0.05 m at 10 Hz",
        _FIXES + "48_an_ins_carries_on_between_fixes_where_a_receiver_alone_cannot"),
    Row(49, "heading needs turns", "A-1", "", "0.0075 deg after an S-turn, 0.31 without",
        "tests/studies/test_linear_flight.py::test_49_71_tilt_converges_and_heading_needs_turns",
        linear.turn_for_heading),
    Row(50, "rates of GNSS", "A-1", "", "within 10 % from 1 to 10 Hz; V_D gains 25 %",
        "tests/studies/test_linear_flight.py::test_50_the_rate_of_the_receiver_changes_little"),
    Row(51, "skewed triad", "B-0", "no formula", "noise gains 2 %",
        _TERMS + "a_skewed_triad_gives_the_force_back_and_the_noise_gains_of_the_register"),
    Row(52, "norm of the quaternion", "B-N", "|L| - 1 >= eps", "| |L| - 1 | < eps always",
        _MECH + "52_the_norm_stays_within_its_threshold", measure.normalize),
    Row(53, "attitude error integral", "B-7", "o L_0 last: 4e-6", "o L(t): 1e-11",
        _MECH + "53_the_quaternion_error_is_the_integral", measure.integrate_quaternion_error),
    Row(54, "heading and cross-track", "B-8", "", "1000 km, 0.1 deg: 1738.2 m",
        _MECH + "54_heading_and_cross_track",
        measure.cross_track),
    Row(55, "delays of ranges", "B-10", "+dD_Tr; 8.8 m", "-dD_Tr; Klobuchar 23.784 m",
        "tests/signals/test_delays.py::test_klobuchar_of_the_register", measure.ionosphere),
    Row(56, "iterated least squares", "B-13", "", "6 iterations from the center",
        _SQUARES + "from_the_center_of_the_earth_in_six_steps"),
    Row(57, "Doppler velocity", "B-14b", "no formula", "noise-free 1e-9 m/s",
        _SQUARES + "doppler_velocity_is_exact"),
    Row(58, "generic error filter", "B-19", "F(z)", "f(z): = the first filter 1e-9",
        "tests/plugins/papers/test_second_source.py::test_58_the_generic_filter_is_the_first_one"),
    Row(59, "vector matching", "B-V", "no formula", "3.7 mrad; sds 10 %",
        "tests/plugins/papers/test_second_source.py::test_59_vectors_find_a_misalignment_of_3_7_mrad",
        measure.match_directions),
    Row(60, "6-DOF truth", "A-2.4", "", "there and back < 1 m in 600 s",
        _TRUTH + "at_200_hz_ten_minutes_come_back_within_a_millimeter_and_a_microradian",
        flights.come_back),
)  # fmt: skip
"""Every row, in order."""
