"""Exceedances of a flight on wings: excursions from runway and taxiway, hard landing, stall and overspeed.

As flight data monitoring reports them: events of kind "exceedance" of the truth; the flight is not changed.
An aircraft without a stated limit has no exceedance of it.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np

from bench.core.mathematics.arrays import BoolArray, FloatArray
from bench.core.mathematics.earth import matrix_en, to_ecef
from bench.core.mathematics.rotation import rotate
from bench.core.records.data import EventRow
from bench.core.records.flight_specs import FlightSpec, Runway
from bench.simulation.flight.ground.taxiway import Taxiway
from bench.simulation.flight.guidance.shaping import GUIDANCE_RATE
from bench.simulation.flight.increments import earth_relative
from bench.simulation.flight.jsbsim_units import FT
from bench.simulation.flight.truth import Stretch

_AIR_GAS = 287.05287  # gas constant of dry air [J/(kg K)], ISO 2533
_HEATS = 1.4  # ratio of the specific heats of air, ISO 2533
_SEA_LEVEL_DENSITY = 1.225  # [kg/m^3], ISO 2533
_AIRBORNE = 1.0  # off its wheels for so long an aircraft flies; a hop of the landing roll is shorter [s]
_AT_THRESHOLD = 1.0  # what stands at the threshold may stand this much before it [m]
_STAND = 30.0  # radius of the stand that a flight starts at [m]
_LEAST_SINK, _MOST_SINK = 7.0 * FT, 10.0 * FT  # bounds of the limit descent velocity [m/s]


def limit_sink(category: str, wing_loading: float) -> tuple[float, str]:
    """Return the sink rate at touch-down that a landing gear is designed for [m/s], and its source.

    Transport aircraft: 10 ft/s, 14 CFR 25.473(a)(2). Light aircraft: 4.4 (W/S)^(1/4) ft/s, W/S in lb/ft^2, 7
    to 10 ft/s, 14 CFR 23.473(d) of 2014. UAV and fighters have no such rule: they are assumed to be light and
    transport aircraft.

    Parameters
    ----------
    category : str
        Class of the aircraft, a key of ``MESH_OF_CLASS``.
    wing_loading : float
        Weight over wing area [lbf/ft^2].

    Examples
    --------
    >>> sink, rule = limit_sink("light", 15.0)
    >>> round(sink, 2), rule
    (2.64, '14 CFR 23.473(d)')
    """
    if category in ("transport", "fighter"):
        return _MOST_SINK, "14 CFR 25.473(a)(2)"
    return min(max(4.4 * wing_loading**0.25 * FT, _LEAST_SINK), _MOST_SINK), "14 CFR 23.473(d)"


class Exceedances:
    """Exceedances of one flight, collected from its segments; a multirotor has none.

    Parameters
    ----------
    spec : FlightSpec
        The flight.
    fdm : FGFDMExec
        Its model, with the weight of the start.
    rate : float
        Rows of air data and contacts per second [Hz].
    taxiways : sequence of Taxiway
        Taxiways beside the runway; legs add theirs.
    """

    def __init__(
        self, spec: FlightSpec, fdm: Any, rate: float = GUIDANCE_RATE, taxiways: Sequence[Taxiway] = ()
    ) -> None:
        self._spec, self._envelope, self._rate = spec, spec.aircraft.envelope, rate
        self._taxiways = taxiways
        weight, area = fdm["inertia/weight-lbs"], fdm["metrics/Sw-sqft"]
        loading = weight / area if area > 0 else math.inf
        self._sink, self._rule = limit_sink(spec.aircraft.category, loading)
        self._touched, self._sank = True, 0.0  # wheels and sink rate of the last row [m/s]
        self._off = math.inf  # for how long no wheel has touched [s]
        self._spans: dict[str, tuple[float, float, int]] = {}  # text: first and last time [s], rows
        self._worst: dict[str, float] = {}

    def add(self, stretch: Stretch) -> Stretch:
        """Process the next segment and return it."""
        if not self._spec.aircraft.hovers and len(stretch.air):
            t, wheels = stretch.t_air, stretch.ground[:, 2] > 0
            self._add_landings(t, wheels, stretch.ground[:, 1])
            self._add_envelope(t, self._find_airborne(wheels), stretch.air)
            if self._spec.runway is not None and wheels.any():
                self._add_excursions(t, wheels, stretch, self._spec.runway)
        return stretch

    def rows(self) -> list[EventRow]:
        """Return an event for each kind of exceedance, in the order in which they began."""
        found = list[EventRow]()
        for text, (first, last, count) in sorted(self._spans.items(), key=lambda one: one[1]):
            often = "once" if count == 1 else f"{count} times"
            lasting = often if text.startswith("hard") else f"for {count / self._rate:.4g} s"
            found.append((first, last, "exceedance", f"{text.format(self._worst[text])}, {lasting}"))
        return found

    def _note(self, text: str, beyond: BoolArray, t: FloatArray, value: FloatArray) -> None:
        """Add the rows that are beyond a limit; ``text`` takes the largest of their values."""
        k = np.flatnonzero(beyond)
        if len(k):
            first, _, count = self._spans.get(text, (float(t[k[0]]), 0.0, 0))
            self._spans[text] = (first, float(t[k[-1]]), count + len(k))
            self._worst[text] = max(self._worst.get(text, -math.inf), float(value[k].max()))

    def _add_landings(self, t: FloatArray, wheels: BoolArray, sink: FloatArray) -> None:
        earlier = np.concatenate([[self._touched], wheels[:-1]])
        before = np.concatenate([[self._sank], sink[:-1]])  # the gear has slowed the sink of the touch itself
        self._touched, self._sank = bool(wheels[-1]), float(sink[-1])
        hard = wheels & ~earlier & (before > self._sink)
        text = f"hard landing: touch-down at {{:.2f}} m/s, beyond {self._sink:.2f} m/s of {self._rule}"
        self._note(text, hard, t, before)

    def _find_airborne(self, wheels: BoolArray) -> BoolArray:
        rows = np.arange(len(wheels))
        last = np.maximum.accumulate(np.where(wheels, rows, -1))
        off = (rows - last) / self._rate + np.where(last < 0, self._off, 0.0)
        self._off = float(off[-1])
        return off > _AIRBORNE

    def _add_envelope(self, t: FloatArray, airborne: BoolArray, air: FloatArray) -> None:
        limits = self._envelope
        pressure, temperature, true, calibrated, attack = np.where(np.isfinite(air), air, np.nan)[:, :5].T
        density = pressure / (_AIR_GAS * temperature)
        equivalent = true * np.sqrt(density / _SEA_LEVEL_DENSITY)
        mach = true / np.sqrt(_HEATS * _AIR_GAS * temperature)
        measured = (
            ("stall: angle of attack up to {:.1f} deg", np.rad2deg(attack), np.rad2deg(limits.stall), " deg"),
            ("overspeed: calibrated airspeed up to {:.1f} m/s", calibrated, limits.max_cas, " m/s"),
            ("overspeed: equivalent airspeed up to {:.1f} m/s", equivalent, limits.max_eas, " m/s"),
            ("overspeed: Mach up to {:.3f}", mach, limits.max_mach, ""),
        )
        for text, value, limit, unit in measured:
            if limit:
                self._note(f"{text}, beyond {limit:.4g}{unit}", airborne & (value > limit), t, value)

    def _add_excursions(self, t: FloatArray, wheels: BoolArray, stretch: Stretch, runway: Runway) -> None:
        motion, rows = stretch.motion, np.flatnonzero(wheels)
        t = t[rows]
        at = np.round(t / motion.dt).astype(int) - stretch.first + stretch.before
        at = np.minimum(at, len(motion.epa) - 1)
        lla, _ = earth_relative(motion.epa[at], motion.pos_i[at], motion.vel_i[at])
        from_threshold = to_ecef(lla) - to_ecef([runway.lat, runway.lon, runway.alt])
        pos_n = from_threshold @ matrix_en(runway.lat, runway.lon)
        pos_n = pos_n - rotate(motion.q_nb[at], self._spec.aircraft.imu_b)  # of the center of gravity
        c, s = math.cos(runway.heading), math.sin(runway.heading)
        along, right = pos_n[:, 0] * c + pos_n[:, 1] * s, pos_n[:, 1] * c - pos_n[:, 0] * s
        edge, end = 0.5 * runway.width, runway.length or math.inf
        beyond = np.max([np.abs(right) - edge, -along - _AT_THRESHOLD, along - end], axis=0)
        ours = self._add_taxiway_excursions(t, pos_n[:, :2], beyond, runway)
        for side, off in (("right", right), ("left", -right)):
            text = f"runway excursion: {{:.0f}} m {side} of the centerline, beyond the edge at {edge:g} m"
            self._note(text, ours & (off > edge), t, off)
        before = ours & (along < -_AT_THRESHOLD)
        self._note("runway excursion: {:.0f} m before the threshold", before, t, -along)
        text = f"runway excursion: {{:.0f}} m beyond the end of {runway.length:g} m"
        self._note(text, ours & (along > end), t, along - runway.length)

    def _add_taxiway_excursions(
        self, t: FloatArray, pos: FloatArray, beyond: FloatArray, runway: Runway
    ) -> BoolArray:
        """Return the rows off all that is paved that are nearer to the runway than to a taxiway.

        ``beyond`` is how far places are beyond the edge of the runway [m].
        """
        ours = beyond > 0
        if self._spec.on_ground:  # where it starts is a stand
            lla = [self._spec.lat, self._spec.lon, runway.alt]
            away = to_ecef(lla) - to_ecef([runway.lat, runway.lon, runway.alt])
            ours &= np.hypot(*(pos - (away @ matrix_en(runway.lat, runway.lon))[:2]).T) > _STAND
        rows = np.flatnonzero(ours)
        if not len(rows) or not self._taxiways:
            return ours
        off = np.array([taxiway.beyond(pos[rows]) for taxiway in self._taxiways])
        nearest, least = off.argmin(axis=0), off.min(axis=0)
        for k, taxiway in enumerate(self._taxiways):
            text = f"taxiway excursion: {{:.1f}} m off its centerline, beyond the edge at {taxiway.edge:g} m"
            left = (nearest == k) & (least > 0) & (least < beyond[rows])
            self._note(text, left, t[rows], least + taxiway.edge)
        ours[rows] = least >= beyond[rows]
        return ours
