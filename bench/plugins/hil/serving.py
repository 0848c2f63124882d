"""Fly a profile with a client, and evaluate the flight like any run."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Literal

from bench import pipeline
from bench.core.records.flight_specs import FlightSpec
from bench.core.records.run_result import RunResult
from bench.core.records.specs import CLIENT, Profile
from bench.core.words.exceptions import ConfigError, EstimatorStoppedError
from bench.core.words.stages import Progress, Stage, ignore
from bench.io.streams.streaming import listen, parse_address
from bench.pipeline import closed_loop
from bench.plugins.hil.flight_messages import VERSION
from bench.plugins.hil.flight_session import FlightFacts, FlightSession
from bench.plugins.hil.mavlink_session import ActuatorChannels, MavlinkSession
from bench.plugins.hil.served import load_served
from bench.simulation.flight.guidance.steering import Commands

Gives = Literal["estimate", "commands"]


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
        Channels of an autopilot that speaks MAVLink and commands the controls.
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
        profile = load_served(profile, overrides, seed=seed, mavlink=mavlink is not None)
    elif seed is not None or overrides is not None:
        raise ConfigError("bench.serve: with a profile already read, seed and overrides change nothing")
    if profile.guidance is None or profile.guidance.navigation.use != CLIENT:
        raise ConfigError(
            f'{profile.name}: bench serve needs [guidance] navigation = "{CLIENT}"; '
            "by its name or path a profile is read so"
        )
    if math.isnan(rate) or rate < 0:
        raise ConfigError(f"--rate {rate:g} must not be negative; 0 or inf flies as fast as possible")
    if not (math.isfinite(patience) and patience > 0):
        raise ConfigError(f"--patience {patience:g} must be above 0, in seconds")
    assert isinstance(profile.flight, FlightSpec)
    pipeline.build_estimators(profile)  # fails before a client comes
    if truth and mavlink is None:
        raise ConfigError("--truth needs --mavlink: the messages of bench contain no truth")
    steers = gives == "commands" or mavlink is not None
    if steers:
        closed_loop.find_length(profile)
    else:
        closed_loop.check_legs(profile)
    length = profile.flight.duration
    facts = FlightFacts(profile.flight.rate, profile.guidance.period, math.nan if length is None else length)
    commands = Commands()
    session: FlightSession | MavlinkSession
    with listen(*parse_address(f"--bind {address}", address, remote=remote), say) as server:
        if mavlink is None:
            session = FlightSession(server, facts, commands, rate, patience, steers=steers)
        else:
            alt = profile.flight.alt
            session = MavlinkSession(server, commands, rate, patience, channels=mavlink, truth=truth, alt=alt)
        watch = session.watch if truth and isinstance(session, MavlinkSession) else None
        try:
            session.wait(say)
            flown = closed_loop.serve(profile, run, session, commands if steers else None, watch)
        except BaseException:
            session.close("the flight was ended", good=False)
            raise
        session.close(flown.ended or "the flight is over", good=not flown.ended)
        if not steers and not session.estimates:
            say("the client gave no estimate: guidance read the truth")
    seconds = float(flown.truth.t[-1])
    try:
        result = pipeline.run(profile, run, truth=flown.truth, steered=flown.answers)
    except ConfigError as error:  # the flight is too short
        ended = flown.ended or "the flight is over"
        raise EstimatorStoppedError(
            f"{ended} after {seconds:g} s, nothing can be evaluated: {error}"
        ) from None
    spoken = VERSION if mavlink is None else "MAVLink"
    gives, turn = "commands" if steers else gives, profile.guidance.period
    told = {"gives": gives, "messages": spoken, "turn_s": turn, "ended": flown.ended}
    result = replace(result, provenance={**result.provenance, "served": told})
    return ServedRun(result, seconds, flown.ended, session.latest)
