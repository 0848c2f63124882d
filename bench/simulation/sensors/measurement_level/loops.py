"""The tracking loops of a receiver: noise by C/N0, multipath, ranges on each carrier, and its settings."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from bench.core.mathematics.arrays import FloatArray, IntArray
from bench.core.records.sensor_specs import Fault
from bench.core.records.sky_spec import SkySpec
from bench.simulation.signals.orbits import C
from bench.simulation.signals.processing import ErrorBudget, Processing

_CHIP = (C / 1.023e6, C / 0.511e6, C / 1.023e6 / np.sqrt(3.0), C / 2.046e6)
"""Chip of the civil code by system [m], their ICDs; the correlation of BOC(1,1) is three times as steep."""
_DECIBEL = np.log(10.0) / 10.0
_MULTIPATH_DECAY = float(np.deg2rad(10.0))  # [rad], RTCA DO-229D, appendix J


def code_sd(cn0: FloatArray, chip: FloatArray, spec: SkySpec) -> FloatArray:
    """Return the standard deviation of the thermal noise of the code loop [m] at C/N0 [dB-Hz].

    Notes
    -----
    Noncoherent early-minus-late power discriminator, wide front end: Kaplan and Hegarty, Understanding GPS,
    2nd ed. (2006), eq. 5.23: ``sqrt(B d / (2 C/N0) (1 + 2 / ((2 - d) T C/N0)))`` chips [m], with bandwidth B,
    spacing d and integration T of the spec.
    """
    ratio = np.exp(_DECIBEL * cn0)
    d = spec.dll_spacing
    loss = 1.0 + 2.0 / ((2.0 - d) * spec.integration * ratio)
    sd: FloatArray = chip * np.sqrt(spec.dll_bandwidth * d / (2.0 * ratio) * loss)
    return sd


def doppler_sd(cn0: FloatArray, frequency: FloatArray, spec: SkySpec) -> FloatArray:
    """Return the standard deviation of the thermal noise of the frequency loop as a range rate [m/s].

    Notes
    -----
    Kaplan and Hegarty (2006), eq. 5.9, at high C/N0 (F = 1):
    ``wavelength / (2 pi T) sqrt(4 B / (C/N0) (1 + 1 / (T C/N0)))``.
    """
    ratio = np.exp(_DECIBEL * cn0)
    T = spec.integration
    noise = np.sqrt(4.0 * spec.fll_bandwidth / ratio * (1.0 + 1.0 / (T * ratio)))
    sd: FloatArray = C / frequency / (2.0 * np.pi * T) * noise
    return sd


def find_loop_noise(
    system: IntArray, cn0: FloatArray, frequency: FloatArray, spec: SkySpec
) -> tuple[FloatArray, FloatArray]:
    """Return the thermal noise of code [m] and range rate [m/s] of rows (K,) of a carrier [Hz]."""
    return code_sd(cn0, np.array(_CHIP)[system], spec), doppler_sd(cn0, frequency, spec)


def track_bands(
    common: FloatArray, ionosphere: FloatArray, rate: FloatArray, cn0: FloatArray, el: FloatArray,
    system: IntArray, frequency: FloatArray, sky: SkySpec, errors: Any, scripted: Sequence[Fault],
) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:  # fmt: skip
    """Return pseudoranges, range rates and C/N0 (K, bands), and the noise of both on the first (2, K)."""
    shadow = sky.multipath_zenith_sd + sky.multipath_horizon_sd * np.exp(-el / _MULTIPATH_DECAY)
    pseudorange, range_rate, strength = np.empty((3, *frequency.shape))
    tracking = np.empty((2, len(cn0)))
    for band in range(frequency.shape[1]):
        strength[:, band] = cn0 - band * sky.second_band_loss
        pseudorange[:, band] = common + ionosphere * (frequency[:, 0] / frequency[:, band]) ** 2
        noise, doppler = find_loop_noise(system, strength[:, band], frequency[:, band], sky)
        if sky.dll_bandwidth > 0:
            pseudorange[:, band] += noise * errors.draw_white(f"code.{band + 1}")
        burst = errors.draw_bursts(scripted, f"code.{band + 1}")
        if burst is not None:
            pseudorange[:, band] += noise * burst
        if max(sky.multipath_zenith_sd, sky.multipath_horizon_sd) > 0:
            slow = errors.draw_markov(f"multipath.{band + 1}", sky.multipath_correlation)
            pseudorange[:, band] += shadow * slow
        range_rate[:, band] = rate
        if sky.fll_bandwidth > 0:
            range_rate[:, band] += doppler * errors.draw_white(f"doppler.{band + 1}")
        burst = errors.draw_bursts(scripted, f"doppler.{band + 1}")
        if burst is not None:
            range_rate[:, band] += doppler * burst
        if band == 0:
            tracking[:] = noise, doppler
    return pseudorange, range_rate, strength, tracking


def make_processing(sky: SkySpec) -> Processing:
    """Return the settings of the fix computation in the receiver, with the true sigmas of its errors."""
    return Processing(
        budget=ErrorBudget(
            zenith_ionosphere=sky.ionosphere_sd,
            ionosphere_share=sky.ionosphere_share,
            ionosphere_decay=sky.ionosphere_decay,
            zenith_troposphere=sky.troposphere_sd,
            multipath_zenith=sky.multipath_zenith_sd,
            multipath_horizon=sky.multipath_horizon_sd,
            second_band=float(10.0 ** (sky.second_band_loss / 20.0)),
        ),
        systems=sky.systems,
        ionosphere="free" if sky.bands == 2 else "klobuchar",
        mask=sky.elevation_mask,
        false_alarm=sky.false_alarm,
    )
