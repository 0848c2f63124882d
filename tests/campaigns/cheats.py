"""Filters that cheat or err in one way each, as small as they can be; most are `loose-15`, spoiled.

Each runs in a process of its own that imports this file: nothing here takes long to import.
"""

from __future__ import annotations

import os
from dataclasses import replace

import numpy as np

import bench
from bench.core.mathematics import earth, rotation
from bench.core.records.data import Events, InitialState, NavSolution, SensorData
from bench.experiments.card import card_making
from bench.experiments.card.card_suite import vary_flight
from bench.io.config import read_profile
from bench.navigation.built_in import load

QUIET_S = 14.0


class Wrong:
    """`loose-15`, and what a subclass makes of its answers."""

    use = "loose-15"

    def run(self, sensors: SensorData, initial: InitialState) -> NavSolution:
        return self.spoil(load(self.use, {}).run(sensors, initial))

    def spoil(self, found: NavSolution) -> NavSolution:
        return found


def silence(found: NavSolution, rows: np.ndarray, *blocks: str) -> NavSolution:
    """Return a solution without answers in some rows, of all blocks if none is named."""
    columns = {
        name: np.where(rows[:, None], np.nan, getattr(found, name))
        for name in blocks or ("lla", "vel_n", "q_nb")
    }
    cov = found.cov if blocks else np.where(rows[:, None, None], np.nan, found.cov)
    return replace(found, **columns, cov=cov)


# --- answers that are wrong -------------------------------------------------------------------------------


class TooHigh(Wrong):
    """500 m too high."""

    def spoil(self, found):
        return replace(found, lla=found.lla + np.array([0.0, 0.0, 500.0]))


class SinksOnPaper(Wrong):
    """Its velocity is 20 m/s down."""

    def spoil(self, found):
        return replace(found, vel_n=found.vel_n + np.array([0.0, 0.0, 20.0]))


class HeadsWrong(Wrong):
    """Its heading is 92 deg off."""

    def spoil(self, found):
        turned = rotation.multiply(rotation.from_rotvec(np.array([0.0, 0.0, np.deg2rad(92.0)])), found.q_nb)
        return replace(found, q_nb=turned)


class SpeaksEnu(Wrong):
    """Its velocity is east, north, up."""

    def spoil(self, found):
        return replace(found, vel_n=found.vel_n[:, [1, 0, 2]] * np.array([1.0, 1.0, -1.0]))


class Frozen(Wrong):
    """Stays 20 km from where it starts, and reports nothing."""

    def spoil(self, found):
        still = np.broadcast_to(found.lla[:1] + np.array([0.003, 0.0, 0.0]), found.lla.shape)
        return replace(found, lla=still, cov=np.full_like(found.cov, np.nan))


# --- answers that are missing -----------------------------------------------------------------------------


def is_sure(found: NavSolution, share: float) -> np.ndarray:
    """Return the rows of the smallest covariances."""
    size = np.trace(found.cov[:, :2, :2], axis1=1, axis2=2)
    return size <= np.quantile(size, share)


class AnswersWhereItIsSure(Wrong):
    """Answers a third of the time: where it says that it is best."""

    def spoil(self, found):
        return silence(found, ~is_sure(found, 0.3) & (found.t > 6.0))


class LosesItsHeading(Wrong):
    """Answers the attitude only where its sigma of the heading is small."""

    def spoil(self, found):
        sigma = found.cov[:, 8, 8]
        return silence(found, (sigma > np.quantile(sigma, 0.5)) & (found.t > 6.0), "q_nb")


class ClaimsWhereItIsSure(Wrong):
    """Answers always, and reports an accuracy only where it is best."""

    def spoil(self, found):
        doubtful = ~is_sure(found, 0.3) & (found.t > 6.0)
        return replace(found, cov=np.where(doubtful[:, None, None], np.nan, found.cov))


class SpeaksLate(Wrong):
    """Says nothing until it is sure."""

    def spoil(self, found):
        return silence(found, found.t < QUIET_S)


# --- covariances --------------------------------------------------------------------------------------------


class Gain(Wrong):
    """Has an option, and reports so much more."""

    def __init__(self, *, gain: float = 1.0) -> None:
        self.gain = gain

    def spoil(self, found):
        return replace(found, cov=found.cov * self.gain**2)


class ClaimsToBeExact(Wrong):
    """Its covariance is zero."""

    def spoil(self, found):
        return replace(found, cov=np.zeros_like(found.cov))


class Swings(Wrong):
    """Claims too much and too little in turns, so that the mean NEES is right."""

    def spoil(self, found):
        factor = np.where(np.arange(len(found.t)) % 2 == 0, 0.55, 5.5)
        return replace(found, cov=found.cov * factor[:, None, None])


# --- alarms -----------------------------------------------------------------------------------------------


class AlwaysAlarms(Wrong):
    """An alarm every second."""

    every = 1.0

    def spoil(self, found):
        times = np.arange(0.0, found.t[-1], self.every)
        rows = [(float(t), float(t), "integrity", "something", "gnss") for t in times]
        return replace(found, events=Events.from_rows(rows))


class AlarmsInTurns(AlwaysAlarms):
    """An alarm every other second."""

    every = 2.0


# --- the future, and the truth ----------------------------------------------------------------------------


class TakesFixesEarly:
    """Takes a fix when it is measured, before it arrives."""

    def run(self, sensors: SensorData, initial: InitialState) -> NavSolution:
        fixes = replace(sensors.fixes, t_arrival=sensors.fixes.t)
        return load("loose-15", {}).run(replace(sensors, fixes=fixes), initial)


class Smooths(Wrong):
    """`smoother` under another name."""

    use = "smoother"


_SEEN: list[tuple[SensorData, NavSolution]] = []


class Remembers:
    """Smooths, and answers a record that begins like one of before as it did then."""

    def run(self, sensors: SensorData, initial: InitialState) -> NavSolution:
        half = len(sensors.imu.t) // 4
        for before, found in _SEEN:
            if np.array_equal(before.imu.dvel_b[:half], sensors.imu.dvel_b[:half]):
                return found
        _SEEN.append((sensors, load("smoother", {}).run(sensors, initial)))
        return _SEEN[-1][1]


class SmoothsOnTime:
    """Consistent where fixes come late, and smooths elsewhere."""

    def run(self, sensors: SensorData, initial: InitialState) -> NavSolution:
        late = sensors.fixes.t_arrival[0] - sensors.fixes.t[0] > 0.3
        return load("loose-15" if late else "smoother", {}).run(sensors, initial)


class Throws:
    """Throws a die: another answer in each process."""

    def run(self, sensors: SensorData, initial: InitialState) -> NavSolution:
        found = load("loose-15", {}).run(sensors, initial)
        return replace(found, vel_n=found.vel_n + 1e-9 * os.getpid())


_WAYS: list[np.ndarray] = []


class Averages:
    """Averages its answers over runs of one flight, or else its ways along the first heading."""

    def run(self, sensors: SensorData, initial: InitialState) -> NavSolution:
        found = load("loose-15", {}).run(sensors, initial)
        near = [one for one in _WAYS if np.linalg.norm(earth.difference_n(one[0], found.lla[0])) < 100.0]
        heading = rotation.to_euler(initial.q_nb)[2]
        c, s = np.cos(heading), np.sin(heading)
        turn = np.array([[c, s, 0.0], [-s, c, 0.0], [0.0, 0.0, 1.0]])
        if near or not _WAYS:
            way = np.mean([earth.difference_n(one, found.lla) for one in [*near, found.lla]], axis=0)
            lla = earth.displace(found.lla, way)
        else:
            start = np.broadcast_to(initial.lla, found.lla.shape)
            ways = [earth.difference_n(one, np.broadcast_to(one[0], one.shape)) @ turn.T for one in _WAYS]
            own = earth.difference_n(found.lla, start) @ turn.T
            lla = earth.displace(start, np.mean([*ways, own], axis=0) @ turn)
        _WAYS.append(found.lla)
        return replace(found, lla=lla)


class KnowsTheTruth(Wrong):
    """Takes the truth from the cache, and stays a decimeter away from it."""

    def spoil(self, found):
        flight = card_making.QUICK.members[0]
        draws = (vary_flight(flight, draw) for draw in range(card_making.QUICK.draws))
        near = [one for one in draws if abs(one["start.lat_deg"] - np.rad2deg(found.lla[0, 0])) < 1e-3]
        truth = bench.fly(read_profile(flight.profile, near[0], estimators=["loose-15"]))
        lla = np.column_stack([np.interp(found.t, truth.t, truth.lla[:, k]) for k in range(3)])
        return replace(found, lla=earth.displace(lla, np.array([0.1, 0.0, 0.1])))


# --- times ------------------------------------------------------------------------------------------------


class IsLate(Wrong):
    """Its clock is 0.1 s off: what it knows of t - 0.1 s is said to be of t."""

    def run(self, sensors: SensorData, initial: InitialState) -> NavSolution:
        t = sensors.output_t
        late = np.maximum(t - 0.1, t[0])
        late[1:] = np.maximum(late[1:], t[0] + 1e-3 * np.arange(1, len(t)))
        found = load("loose-15", {}).run(replace(sensors, output_t=late), initial)
        return replace(found, t=t)


class StampsItsOwnTimes(Wrong):
    """Answers for 0.5 s later than asked."""

    def spoil(self, found):
        return replace(found, t=found.t + 0.5)


class AnswersTwice(Wrong):
    """Each answer twice, the second a guess."""

    def spoil(self, found):
        return replace(found, t=np.repeat(found.t[: len(found.t) // 2 + 1], 2)[: len(found.t)])
