"""Fly a profile with a client, and evaluate the flight like any run."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Literal

import numpy as np

from bench import pipeline
from bench.core.records.flight_specs import FlightSpec
from bench.core.records.run_result import RunResult
from bench.core.records.specs import CLIENT, Profile
from bench.core.words.exceptions import ConfigError, EstimatorStoppedError
from bench.core.words.stages import Progress, Stage, ignore
from bench.io.streams.streaming import listen, parse_address
from bench.pipeline import autopilot_flight, closed_loop
from bench.pipeline.autopilot_flight import check_flight
from bench.plugins.hil.actuator_channels import ActuatorChannels
from bench.plugins.hil.flight_messages import VERSION
from bench.plugins.hil.flight_session import FlightFacts, FlightSession
from bench.plugins.hil.json_session import JsonSession
from bench.plugins.hil.mavlink_session import MavlinkSession
from bench.plugins.hil.served import load_served
from bench.simulation.flight.guidance.steering import Commands

Gives = Literal["estimate", "commands"]
_FARTHEST = 110.0  # of the geoid from the ellipsoid [m]; EGM96: -107 to 86


@dataclass(frozen=True, slots=True)
class ServedRun:
    """A served flight."""

    result: RunResult
    flown: float  # duration of the flight [s]
    ended: str  # why the client did not fly to the end; empty if it did
    latest: float  # largest delay behind --rate [s]


def serve(
    profile: str | Path | Profile,
    run: int = 0,
    *,
    seed: int | None = None,
    overrides: Mapping[str, Any] | None = None,
    address: str = "127.0.0.1:5700",
    remote: bool = False,
    gives: Gives = "estimate",
    rate: float = 0.0,
    patience: float = 60.0,
    mavlink: ActuatorChannels | None = None,
    ardupilot: ActuatorChannels | None = None,
    undulation: float = 0.0,
    truth: bool = False,
    progress: Progress | None = None,
) -> ServedRun:
    """Wait for one client, fly the profile with it in lock-step, and evaluate the flight.

    Parameters
    ----------
    profile : str, Path or Profile
        Built-in name, path of a TOML file, or a loaded profile with ``[guidance] navigation = "client"``.
    run : int, optional
        Number of the run. Default: 0.
    seed, overrides
        See `bench.read_profile`; not with a loaded profile.
    address : str, optional
        ``IP:PORT`` to wait at; port 0 takes any free port.
    remote : bool, optional
        Permit clients on other machines. Default: no.
    gives : {"estimate", "commands"}
        "estimate": guidance follows the legs with the client's estimate. "commands": the client flies, legs
        are left out.
    rate : float, optional
        Largest rate, seconds of flight per second; 0 or infinity: as fast as possible.
    patience : float, optional
        Longest silence of the client [s]. Default: 60.
    mavlink : ActuatorChannels, optional
        Outputs of an autopilot that speaks MAVLink as PX4 does.
    ardupilot : ActuatorChannels, optional
        Outputs of ArduPilot's SITL, by its JSON interface.
    undulation : float, optional
        Height of the geoid above the ellipsoid where the flight is [m]: an autopilot gets heights above mean
        sea level. Default: 0.
    truth : bool, optional
        Also send the truth, as HIL_STATE_QUATERNION. Default: no.
    progress : callable, optional
        Called with a `Stage` when a client connects, leaves or fails.

    Returns
    -------
    ServedRun
        ``result`` (`RunResult`), ``flown`` [s], ``ended``: why the client ended early, or "".

    Raises
    ------
    bench.ConfigError
        If the profile or an argument is wrong, or pymavlink is not installed.
    bench.EstimatorError
        If a filter of the profile cannot be built.
    bench.FlightError
        If the aircraft cannot be loaded or trimmed.
    bench.core.words.exceptions.EstimatorStoppedError
        If the flight ended before it can be evaluated.
    OSError
        If the address cannot be used.

    Examples
    --------
    >>> import bench
    >>> served = bench.serve("approach-closed", address="127.0.0.1:5700")  # doctest: +SKIP
    >>> served.result.metrics  # doctest: +SKIP
    """

    def say(text: str) -> None:
        (progress or ignore)(Stage(text))

    if not isinstance(profile, Profile):
        profile = load_served(profile, overrides, seed=seed)
    elif seed is not None or overrides is not None:
        raise ConfigError("bench.serve: with a profile already read, seed and overrides change nothing")
    _check(profile, rate, patience, undulation)
    pipeline.build_estimators(profile)  # fails before a client comes
    if mavlink is not None and ardupilot is not None:
        raise ConfigError("--mavlink and --ardupilot: one autopilot at a time")
    if truth and mavlink is None:
        raise ConfigError("--truth needs --mavlink: the messages of bench contain no truth")
    where, spec = parse_address(f"--bind {address}", address, remote=remote), profile.flight
    assert isinstance(spec, FlightSpec)
    assert profile.guidance is not None
    spoken: str | int = VERSION
    commands, steps = Commands(), 1.0 / spec.rate
    if mavlink is not None or ardupilot is not None:
        check_flight(profile)
        gives = "commands"
        with listen(*where, say, udp=ardupilot is not None) as server:
            link: MavlinkSession | JsonSession
            if mavlink is not None:
                link = MavlinkSession(
                    server, commands, rate, patience,
                    channels=mavlink, truth=truth, alt=spec.alt, undulation=undulation,
                )  # fmt: skip
            elif ardupilot is not None:
                start = np.array([spec.lat, spec.lon, spec.alt])
                link = JsonSession(server, commands, rate, patience, channels=ardupilot, start=start)
                say(f"start SITL with --home {describe_home(spec, undulation)}")
            flown = _fly(link, lambda: autopilot_flight.fly(profile, run, link, say), say)
            if isinstance(link, MavlinkSession) and link.unanswered:
                say(f"{link.unanswered} of the HIL_SENSOR stayed without an answer")
        latest, spoken = link.pace.latest, "MAVLink" if mavlink is not None else "ArduPilot JSON"
    else:
        steers, steps = gives == "commands", profile.guidance.period
        _check_legs(profile, steers=steers)
        facts = FlightFacts(spec.rate, steps, math.nan if spec.duration is None else spec.duration)
        with listen(*where, say) as server:
            session = FlightSession(server, facts, commands, rate, patience, steers=steers)
            own = commands if steers else None
            flown = _fly(session, lambda: closed_loop.serve(profile, run, session, own), say)
            if not steers and not session.estimates:
                say("the client gave no estimate: guidance read the truth")
        latest = session.pace.latest
    seconds = float(flown.truth.t[-1])
    try:
        result = pipeline.run(profile, run, truth=flown.truth, steered=flown.answers)
    except ConfigError as error:  # the flight is too short
        ended = flown.ended or "the flight is over"
        raise EstimatorStoppedError(
            f"{ended} after {seconds:g} s, nothing can be evaluated: {error}"
        ) from None
    told = {"gives": gives, "messages": spoken, "turn_s": steps, "ended": flown.ended}
    result = replace(result, provenance={**result.provenance, "served": told})
    return ServedRun(result, seconds, flown.ended, latest)


def _fly(
    session: FlightSession | MavlinkSession | JsonSession,
    fly: Callable[[], closed_loop.ServedFlight],
    say: Callable[[str], object],
) -> closed_loop.ServedFlight:
    """Wait for a client, fly, and say good-bye."""
    try:
        session.wait(say)
        flown = fly()
    except BaseException:
        session.close("the flight was ended", good=False)
        raise
    session.close(flown.ended or "the flight is over", good=not flown.ended)
    return flown


def _check(profile: Profile, rate: float, patience: float, undulation: float) -> None:
    """Raise ConfigError for a profile that no client flies, and for figures that are impossible."""
    if profile.guidance is None or profile.guidance.navigation.use != CLIENT:
        raise ConfigError(
            f'{profile.name}: bench serve needs [guidance] navigation = "{CLIENT}"; '
            "by its name or path a profile is read so"
        )
    if math.isnan(rate) or rate < 0:
        raise ConfigError(f"--rate {rate:g} must not be negative; 0 or inf flies as fast as possible")
    if not (math.isfinite(patience) and patience > 0):
        raise ConfigError(f"--patience {patience:g} must be above 0, in seconds")
    if not abs(undulation) <= _FARTHEST:
        raise ConfigError(f"--undulation {undulation:g} must be within {_FARTHEST:g} m: the geoid is")


def _check_legs(profile: Profile, *, steers: bool) -> None:
    """Check that a client can fly a profile in turns, by commands or by estimates."""
    closed_loop.check_rate(profile)
    if steers:
        closed_loop.find_length(profile)
    else:
        closed_loop.check_legs(profile)


def describe_home(spec: FlightSpec, undulation: float) -> str:
    """Return the start of a flight for SITL: latitude, longitude, height above mean sea level, heading."""
    lat, lon, heading = (math.degrees(angle) for angle in (spec.lat, spec.lon, spec.heading))
    return f"{lat:.7f},{lon:.7f},{spec.alt - undulation:.2f},{heading % 360.0:.1f}"
