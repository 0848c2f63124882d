"""Filters that are silent where they err, or claim what is not so: `loose-15`, spoiled in one place each."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from bench.core.mathematics import rotation
from bench.core.records.data import InitialState, NavSolution, SensorData
from tests.campaigns.cheats import Wrong, is_sure, silence

BLOCKS = {"pos": slice(0, 3), "vel": slice(3, 6), "phi": slice(6, 9)}


def scale(found: NavSolution, rows: np.ndarray, factors: np.ndarray) -> NavSolution:
    """Return a solution with sigmas of the nine states times ``factors`` (9,) in some rows (M,)."""
    wide = np.where(rows[:, None], factors, 1.0)
    return replace(found, cov=found.cov * wide[:, :, None] * wide[:, None, :])


def factors(**blocks: float) -> np.ndarray:
    found = np.ones(9)
    for name, value in blocks.items():
        found[BLOCKS[name]] = value
    return found


def turns(found: NavSolution) -> np.ndarray:
    """Rows in which the course turns by more than 3 deg/s."""
    course = np.unwrap(np.arctan2(found.vel_n[:, 1], found.vel_n[:, 0]))
    return np.abs(np.gradient(course, found.t)) > np.deg2rad(3.0)


def share(found: NavSolution) -> np.ndarray:
    """Time of each row as a fraction of the record."""
    return (found.t - found.t[0]) / (found.t[-1] - found.t[0])


# --- silence ----------------------------------------------------------------------------------------------


class SilentInTurns(Wrong):
    def spoil(self, found):
        return silence(found, turns(found))


class SilentAtTheEnd(Wrong):
    def spoil(self, found):
        return silence(found, share(found) > 0.9)


class SilentInTheMiddle(Wrong):
    def spoil(self, found):
        return silence(found, np.abs(share(found) - 0.5) < 0.05)


class SilentEverySecondMinute(Wrong):
    def spoil(self, found):
        return silence(found, (found.t // 60.0) % 2 == 1)


class AnswersEveryFiveSeconds(Wrong):
    def spoil(self, found):
        return silence(found, np.abs(found.t / 5.0 - np.round(found.t / 5.0)) > 1e-6)


class AnswersOnceASecondWhereItIsSure(Wrong):
    """At its own rate of 1 Hz, but not where its covariance is large."""

    def spoil(self, found):
        own = np.abs(found.t - np.round(found.t)) < 1e-6
        return silence(found, ~own | ~is_sure(found, 0.7) & (found.t > 6.0))


class NoHeightInTurns(Wrong):
    def spoil(self, found):
        return silence(found, turns(found), "lla")


class NoVelocityAtTheEnd(Wrong):
    def spoil(self, found):
        return silence(found, share(found) > 0.8, "vel_n")


class NoCovarianceInTurns(Wrong):
    def spoil(self, found):
        return replace(found, cov=np.where(turns(found)[:, None, None], np.nan, found.cov))


class HoldsItsPositionForAMinute(Wrong):
    """Answers with the same numbers, and its covariance of then."""

    def spoil(self, found):
        first = int(np.argmax(share(found) > 0.5))
        rows = (np.arange(len(found.t)) > first) & (found.t < found.t[first] + 60.0)
        return replace(found, lla=np.where(rows[:, None], found.lla[first], found.lla))


# --- claims -----------------------------------------------------------------------------------------------


class TradesAttitudeForVelocity(Wrong):
    """NEES of all nine states is right: velocity pays for the attitude."""

    def spoil(self, found):
        return scale(found, found.t >= 0.0, factors(phi=2.0, vel=0.84))


class BoastsOfPosition(Wrong):
    def spoil(self, found):
        return scale(found, found.t >= 0.0, factors(pos=0.6))


class BoastsOfItsHeading(Wrong):
    def spoil(self, found):
        heading = np.ones(9)
        heading[8] = 0.5
        return scale(found, found.t >= 0.0, heading)


class ModestInVelocity(Wrong):
    def spoil(self, found):
        return scale(found, found.t >= 0.0, factors(vel=2.0))


class BoastsOfItsHeight(Wrong):
    def spoil(self, found):
        height = np.ones(9)
        height[2] = 0.5
        return scale(found, found.t >= 0.0, height)


class BoastsInTheSecondHalf(Wrong):
    def spoil(self, found):
        return scale(found, share(found) > 0.5, np.full(9, 0.6))


class ClaimsTheSameAlways(Wrong):
    """The mean of its covariance."""

    def spoil(self, found):
        return replace(found, cov=np.broadcast_to(0.2 * found.cov.mean(axis=0), found.cov.shape).copy())


class ClaimsOneSigmaForThree(Wrong):
    def spoil(self, found):
        return scale(found, found.t >= 0.0, np.full(9, 1.0 / 3.0))


class SwapsNorthAndEast(Wrong):
    """In its covariance of the position, with a tenth of one."""

    def spoil(self, found):
        odd = np.ones(9)
        odd[0], odd[1] = 0.45, 2.0
        return scale(found, found.t >= 0.0, odd)


class ReportsDegrees(Wrong):
    """Its sigmas of the attitude are in degrees where radians are asked for."""

    def spoil(self, found):
        return scale(found, found.t >= 0.0, factors(phi=180.0 / np.pi))


# --- honest, and odd --------------------------------------------------------------------------------------


class OnceASecond(Wrong):
    """Answers at 1 Hz."""

    def spoil(self, found):
        return silence(found, np.abs(found.t - np.round(found.t)) > 1e-6)


class AttitudeAlone(Wrong):
    """Estimates no position and no velocity."""

    def spoil(self, found):
        cov = np.full_like(found.cov, np.nan)
        cov[:, 6:, 6:] = found.cov[:, 6:, 6:]
        return replace(silence(found, found.t >= 0.0, "lla", "vel_n"), cov=cov)


class SinglePrecision(Wrong):
    """Computes its answers in single precision, but for latitude and longitude."""

    def spoil(self, found):
        short = {name: getattr(found, name).astype(np.float32).astype(float) for name in ("vel_n", "cov")}
        q_nb = found.q_nb.astype(np.float32).astype(float)
        return replace(found, **short, q_nb=q_nb / np.linalg.norm(q_nb, axis=1)[:, None])


class SigmaPoints(Wrong):
    """`ukf` under another name."""

    use = "ukf"


class OtherSign(Wrong):
    """The other quaternion of the same attitude."""

    def spoil(self, found):
        return replace(found, q_nb=-found.q_nb)


class TurnedByTheEarth:
    """Integrates the same start turned by 1e-9 rad: other bits, the same filter."""

    def run(self, sensors: SensorData, initial: InitialState) -> NavSolution:
        turned = rotation.multiply(rotation.from_rotvec(np.array([0.0, 0.0, 1e-9])), initial.q_nb)
        return Wrong().run(sensors, replace(initial, q_nb=turned))


SILENT = (
    SilentInTurns, SilentAtTheEnd, SilentInTheMiddle, SilentEverySecondMinute, AnswersEveryFiveSeconds,
    AnswersOnceASecondWhereItIsSure, NoHeightInTurns, NoVelocityAtTheEnd, NoCovarianceInTurns,
    HoldsItsPositionForAMinute,
)  # fmt: skip
BOASTFUL = (
    TradesAttitudeForVelocity, BoastsOfPosition, BoastsOfItsHeading, ModestInVelocity, BoastsOfItsHeight,
    BoastsInTheSecondHalf, ClaimsTheSameAlways, ClaimsOneSigmaForThree, SwapsNorthAndEast, ReportsDegrees,
)  # fmt: skip
HONEST = (OnceASecond, AttitudeAlone, SinglePrecision, SigmaPoints, OtherSign, TurnedByTheEarth)
