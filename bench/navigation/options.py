"""Options of the built-in filters: each declared once, with limits, default and a description.

A constructor and a profile are checked against the same model; an option of a profile is wrong before the
flight. Adding an option is a field here and its use in the estimator.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Annotated, Any, Literal, TypeVar

from pydantic import (
    AfterValidator,
    BaseModel,
    BeforeValidator,
    ConfigDict,
    ValidationError,
    model_validator,
)
from pydantic_core import PydanticCustomError

from bench.core.words.wording import as_toml, describe_error, read_words, suggest
from bench.navigation.forward_filters import FORWARD


@dataclass(frozen=True)
class Limit:
    """Allowed values of an option, as a check and in words."""

    allows: Callable[[Any], bool]
    words: str

    def __call__(self, value: Any) -> Any:
        """Return an allowed value; reject another."""
        if not self.allows(value):
            raise PydanticCustomError("message", "must be {words}", {"words": self.words})
        return value


def _limited(allows: Callable[[Any], bool], words: str) -> AfterValidator:
    return AfterValidator(Limit(allows, words))


def _is_period(value: object) -> bool:
    number = isinstance(value, int | float) and not isinstance(value, bool)
    return value == "auto" or (number and 0 <= float(value) < float("inf"))  # type: ignore[arg-type]


Positive = Annotated[float, _limited(lambda x: x > 0, "positive")]
NotNegative = Annotated[float, _limited(lambda x: x >= 0, "0 or more")]
Probability = Annotated[float, _limited(lambda x: 0 < x < 1, "between 0 and 1")]
Count = Annotated[int, _limited(lambda n: n >= 1, "at least 1")]
_LIST = BeforeValidator(lambda value: tuple(value) if isinstance(value, list) else value)
Tests = Annotated[tuple[Literal["nis", "trace", "tolerance", "velocity"], ...], _LIST]
Spread = Annotated[tuple[NotNegative, NotNegative, NotNegative], _LIST]
Place = Annotated[tuple[float, float, float], _LIST]


class Options(BaseModel):
    """The options of a filter: no unknown name, no guessed type, no NaN, no infinity."""

    model_config = ConfigDict(extra="forbid", strict=True, frozen=True, allow_inf_nan=False, defer_build=True)

    @classmethod
    def list_wrong(cls, given: Mapping[str, Any], fixed: Mapping[str, Any]) -> list[str]:
        """Return a line for each option that is wrong, beside those that are ``fixed``; empty if none is."""
        try:
            cls(**{**given, **fixed})
        except ValidationError as error:
            return _lines(cls, error, fixed)
        return []


FixAccuracy = Literal["auto", "datasheet", "reported", "larger"]


class GateOptions(Options):
    """Options of every filter that tests its innovations."""

    gate_probability: Probability = 1e-5
    """Chance of rejecting a sound measurement of a matched filter."""
    readmit_after_s: NotNegative = 10.0
    """Time with rejections only, at least three, after which a sensor is re-admitted (A-5.4.7) [s]. The
    filter then inflates the states that can explain a step: position, velocity, clock of the receiver, bias
    of the barometer, radar altimeter or magnetometer, offset of a heading, scale factor of the odometer,
    wind, slip of the wheels. A sensor without such a state stays rejected until it agrees, and a satellite
    while half of the satellites in view agree. After an outage, a fix that shows a drift is used at once."""


class FixOptions(GateOptions):
    """Options of the filters that weight each fix separately."""

    fix_accuracy: FixAccuracy = "auto"
    """Source of the noise of a fix: the datasheet, the value that the receiver reports, or the larger. "auto"
    is the larger for a receiver with `[sky]`, because its accuracy depends on the geometry, "reported" for a
    log with standard deviations of the fixes, else the datasheet."""


class AidingOptions(FixOptions):
    """Options of the filters that take every aiding sensor: which of them they use."""

    gnss: bool = True
    """Use GNSS."""
    baro: bool = True
    """Use the barometer; without barometer and GNSS the IMU alone navigates."""
    airspeed: bool = False
    """Use true airspeed, with the wind as two states."""
    magnetometer: bool = False
    """Use the magnetic field, with states for hard iron, soft iron, scale factors and misalignment."""
    radar: bool = False
    """Use the height above the runway of a radar altimeter, with its bias as a state."""
    odometer: bool = False
    """Use the speed of a wheel, with its scale factor as a state."""
    heading: bool = False
    """Use the heading of two antennas, with its offset and its multipath as states."""

    @property
    def accuracy(self) -> FixAccuracy | None:
        """Return how fixes are weighed; None if none are used."""
        return self.fix_accuracy if self.gnss else None


class IntegrityOptions(GateOptions):
    """Options of the filters that can test a measurement in more than one way."""

    integrity: Tests = ("nis",)
    """Tests that every measurement has to pass: "nis", the normalized innovation squared; "trace", the ratio
    of traces (A-5.4.7). For fixes also "tolerance", the distance from the last used fix propagated by the INS
    (A-5.4.T), and in compiled filters "velocity", the displacement compared with the velocities of the
    receiver."""
    max_acceleration: Positive = 20.0
    """Largest acceleration of the aircraft between fixes, for "tolerance" [m/s^2]."""
    tolerance_sigmas: Positive = 5.0
    """Multiple of the standard deviation of the receiver that "tolerance" allows."""


class FusionOptions(IntegrityOptions, AidingOptions):
    """Options of the compiled filters."""

    covariance_hz: Positive | None = 20.0
    """Rate of the covariance step [Hz]. A rate of the IMU or more, or None in Python, means every sample."""
    trace_ratio: Positive = 10.0
    """Limit of "trace", delta of A-5.4.7."""
    gnss_markov: bool = False
    """Estimate the Markov part of the GNSS errors in six states; with all aiding these are the 22 states of
    A-5.4.1. Loose coupling only."""
    mems: bool = False
    """Estimate scale factors (3 + 3) and the g-sensitivity of the gyros (9)."""
    every_error: bool = False
    """Model every error in the datasheet of the IMU: states for scale factors and misalignments (9 + 9),
    their asymmetry and nonlinearity (6 + 6), temperature (6), g-sensitivity (9) and flicker noise (12), a
    rate random walk in the biases, noise for quantization and jumps."""
    compensate_latency: bool = True
    """Compare a measurement with the state at its time of validity, otherwise with the state at its
    arrival."""
    adaptive_noise: Count | None = None
    """Number of innovations from which the variance of a sensor is estimated; by default the datasheet gives
    the variance."""
    standstill: bool = False
    """Use zero velocity and zero rate while the IMU data show a standstill."""
    time_offset_sd: NotNegative = 0.0
    """Standard deviation of the clock offset of the fixes relative to the IMU [s]. Above 0, the time to add
    to the fixes is a state, time_offset_s."""
    lever_arm_sd: NotNegative = 0.0
    """Standard deviation of each component of the antenna position [m]; above 0 the position is estimated."""
    nonholonomic: bool = False
    """Vehicle on wheels: the rear axle moves neither sideways nor up and down, except for slip and
    suspension. The slip angles, the mounting of the IMU and the position of the axle are states."""
    axle_b: Place = (0.0, 0.0, 0.0)
    """Middle of the rear axle relative to the IMU: forward, right, down [m]."""
    axle_sd: Positive = 1.0
    """Standard deviation of each component of `axle_b` [m]."""
    mounting_sd_deg: Positive = 3.0
    """Standard deviation of yaw and pitch of the IMU axes in the vehicle [deg]."""
    slip_sd_deg: Positive = 0.5
    """Standard deviation of the varying angle between vehicle and motion, due to tires and suspension
    [deg]."""
    slip_s: Positive = 1.0
    """Correlation time of the slip angle [s]."""
    coordinated: bool = False
    """Aircraft in flight: it moves through the air along its nose, except for sideslip and angle of attack.
    Sideslip, angle of attack, wind and gusts are states."""
    alpha_deg: float = 4.0
    """Angle of attack at 1 g and the usual airspeed, from the trim of the aircraft [deg]."""
    alpha_sd_deg: Positive = 2.0
    """Standard deviation of the angle of attack and of the alignment of the IMU with the nose [deg]."""
    gust_sd: Positive = 2.0
    """Standard deviation of the gusts per component [m/s], 2 in moderate turbulence."""

    @property
    def tight(self) -> bool:
        """Return whether the filter uses the ranges of single satellites."""
        return False

    @model_validator(mode="after")
    def _across(self) -> FusionOptions:
        wrong = []
        if self.mems and self.every_error:
            wrong.append("mems = true and every_error = true: the second holds the states of the first")
        if self.nonholonomic and self.coordinated:
            wrong.append(
                "nonholonomic = true and coordinated = true: a vehicle has wheels on the road or flies"
            )
        if "velocity" in self.integrity and (self.tight or not self.gnss):
            wrong.append("integrity = 'velocity' needs fixes: it compares their positions with velocities")
        if self.gnss_markov and not self.gnss:
            wrong.append("gnss_markov = true needs gnss = true: the states are errors of its fixes")
        if self.gnss_markov and self.tight:
            wrong.append("gnss_markov = true needs fixes: tight coupling uses none")
        if self.time_offset_sd > 0 and (self.tight or not self.gnss):
            wrong.append(
                f"time_offset_sd = {self.time_offset_sd:g} needs fixes: the offset is of their clock"
            )
        if self.lever_arm_sd > 0 and not self.gnss:
            wrong.append(
                f"lever_arm_sd = {self.lever_arm_sd:g} needs gnss = true: only its antenna has an arm"
            )
        return _whole(self, wrong)


class TightOptions(FusionOptions):
    """Options of tight coupling."""

    every_error: bool = True

    @property
    def tight(self) -> bool:
        """Return whether the filter uses the ranges of single satellites."""
        return True


class SmootherOptions(FusionOptions):
    """Options of the smoother: the forward filter, and the options of this filter."""

    over: Literal["loose-15", "loose-22", "loose-mems", "loose-full", "tight"] = "loose-full"
    """The forward filter."""

    gnss_markov: bool = True
    every_error: bool = True

    @model_validator(mode="before")
    @classmethod
    def _fix(cls, given: dict[str, Any]) -> dict[str, Any]:
        """Return the options with the fixed options of the forward filter added."""
        over = given.get("over", "loose-full")
        states = FORWARD.get(over, {}) if isinstance(over, str) else {}
        wrong = [
            f"option {name!r} is {as_toml(value)} in over = {as_toml(over)}; leave it out"
            for name, value in states.items()
            if given.get(name, value) != value
        ]
        return _whole({"every_error": over == "tight", **given, **states}, wrong)

    @property
    def tight(self) -> bool:
        """Return whether the filter uses the ranges of single satellites."""
        return self.over == "tight"


class GnssOnlyOptions(FixOptions):
    """Options of the filter without IMU."""

    acceleration: Positive = 3.0
    """Standard deviation of the acceleration along each axis [m/s^2]."""
    correlation_s: Positive = 10.0
    """Correlation time of a maneuver [s]."""


class UnscentedOptions(AidingOptions):
    """Options of the filter by sigma points."""

    covariance_hz: Positive = 10.0
    """Rate of the covariance steps [Hz]; a measurement or an output causes an additional step."""
    spread: Annotated[float, _limited(lambda x: 0 < x <= 1, "above 0 and not above 1")] = 0.5
    """Distance of the sigma points, in units of sqrt(n) standard deviations; 0.5 means two standard
    deviations for 16 states."""


class ClassicOptions(IntegrityOptions):
    """Options of the source's filter."""

    covariance_hz: Positive = 20.0
    """Rate of A-5.4.4 between measurements [Hz]; F uses the mean attitude and specific force of a step."""
    discretization: Literal["van-loan", "euler"] = "van-loan"
    """Phi and Q of the inertial block: exact for F and G of the step, or E + F T and G G' T (A-5.1.D)."""
    rows: Literal[7, 8] = 7
    """Number of measurements in the update. With the published 8 (A-5.4.3), S is singular and its
    pseudo-inverse gives the same solution as 7. If measurements are missing or rejected, the rest of the 7
    are used."""
    form: Literal["joseph", "conventional", "potter", "carlson", "ud"] = "joseph"
    """Form of A-5.4.4 and A-5.4.5. "joseph", and "conventional" with P - K H P, use all rows at once;
    "potter", "carlson" (a square root of P) and "ud" (its factors) use a row at a time. All give the same
    solution."""
    covariance_precision: Literal["double", "single"] = "double"
    """Precision of estimate, covariance and gains; the navigator always has double precision."""
    floor: Annotated[float, _limited(lambda x: 0 <= x < 1, "at least 0 and below 1")] = 0.0
    """Lower limit of each standard deviation, as a fraction of its initial value (A-5.4.F); 0: no limit."""
    trace_limit: Positive = 10.0
    """Largest ratio of "trace"; the source requires 10 or more."""
    monitor_sigmas: Positive = 5.0
    """Difference of barometer and GNSS height, in standard deviations, above which it is reported (row 8 of
    A-5.4.3)."""
    feedback: bool = True
    """Correct the navigator (closed loop), or its output only (open loop, B-20 to B-22)."""
    correction_period: Annotated[
        float | Literal["auto"], BeforeValidator(Limit(_is_period, "0 or more, or 'auto'"))
    ] = 0.0
    """Shortest time between two corrections [s]; 0: after every update. "auto": the time until the attitude
    error, with three standard deviations of P, could reach admissible_deg (A-5.4.10)."""
    admissible_deg: Positive = 1.0
    """Limit of the attitude error for "auto" [deg]."""
    outage: Literal["prediction", "line", "parabola", "schuler"] = "prediction"
    """Errors of the navigator without fixes and without feedback: the prediction of A-5.4.4, or an
    extrapolated curve through earlier estimates (in-flight calibration), with P of the prediction."""
    outage_window: Positive = 120.0
    """Time before an outage from which the curve is fitted [s]."""
    jump_white_sd: Spread = (0.0, 0.0, 0.0)
    """Standard deviation of the jump of a fix when the number of satellites changes: horizontal [m, each
    axis], height [m], velocity [m/s, each axis] (A-5.2.1)."""
    jump_markov_sd: Spread = (0.0, 0.0, 0.0)
    """Standard deviation of the jump of the Markov part of the fixes (A-5.2.2)."""

    @model_validator(mode="after")
    def _across(self) -> ClassicOptions:
        wrong = []
        if "velocity" in self.integrity:
            wrong.append("integrity = 'velocity' is a test of the compiled filters")
        if self.form not in ("joseph", "conventional") and self.rows == 8:
            wrong.append(f"form = {self.form!r} needs rows = 7: the noise of eight rows is not independent")
        if not self.feedback and self.correction_period != 0:
            wrong.append("correction_period needs feedback = true: without it there is no correction")
        if self.feedback and self.outage != "prediction":
            wrong.append(f"outage = {self.outage!r} needs feedback = false: what is fed back is no curve")
        return _whole(self, wrong)


class InvariantOptions(GateOptions):
    """Options of the invariant filter."""

    flat: bool = False
    """Take the Earth as flat and at rest: no Earth rate, no change of gravity."""


class AhrsOptions(GateOptions):
    """Options of the attitude filter."""

    magnetometer: bool = True
    """Use the magnetic field if there is a magnetometer; else the heading drifts from its initial value."""
    gravity_period_s: Positive = 1.0
    """Time over which the specific force is averaged before it is compared with gravity [s]."""
    acceleration_sd: NotNegative = 0.3
    """Sd of the mean acceleration of a period along each axis, independent between periods [m/s^2]. The
    filter raises it while the magnitude of the specific force differs from gravity."""


_OTHERWISE = {"readmit_after": "; use 'readmit_after_s', the time of rejections in seconds"}
"""What to use for options that files of others may still hold."""

_O = TypeVar("_O", bound=Options)
_T = TypeVar("_T")


def _whole(options: _T, wrong: list[str]) -> _T:
    """Return options with valid fields, or reject contradictions between fields."""
    if wrong:
        raise PydanticCustomError("whole", "{words}", {"words": "; ".join(wrong)})
    return options


def read_options(model: type[_O], given: Mapping[str, Any]) -> _O:
    """Return the options of a filter, checked.

    Raises
    ------
    ValueError
        One line for each that is wrong.
    """
    if wrong := model.list_wrong(given, {}):
        raise ValueError("\n".join(wrong))
    return model(**given)


def _lines(model: type[Options], error: ValidationError, fixed: Mapping[str, Any]) -> list[str]:
    lines = []
    for detail in error.errors(include_url=False):
        kind, place, value = detail["type"], detail["loc"], detail["input"]
        key = "".join(f"[{part}]" if isinstance(part, int) else part for part in place)
        if kind == "extra_forbidden":
            known = [name for name in model.model_fields if name not in fixed]
            lines.append(f"unknown option {key!r}{_OTHERWISE.get(key) or suggest(key, known, 'options')}")
        elif kind == "whole":
            lines.append(detail["msg"])
        else:
            lines.append(describe_error(key, value, kind, detail["msg"], detail.get("ctx", {})))
    return lines


def described(model: type[Options]) -> list[tuple[str, str, str]]:
    """Return name, default and description of each option; a dash stands for a default of None."""
    words = read_words(model)
    return [
        (name, "-" if field.default is None else as_toml(field.default), words[name])
        for name, field in model.model_fields.items()
    ]
