"""Spectra of the turbulence beside those of MIL-F-8785C: ``python -m tests.flight.gust_spectra`` draws them.

It writes ``bench/guide/gusts.png``: third octaves of twenty runs of 1,000 s in moderate turbulence, 60 m
above ground at 25 m/s, over the lines of the shaping filters.
"""

from __future__ import annotations

from math import pi

import numpy as np

from bench.cli.verbs.guide import FOLDER
from bench.core.words.palette import SLOTS
from bench.simulation.flight.turbulence.dryden import GUSTS, GustFilters, scales_and_intensities

SPAN = 2.8956  # of the Aerosonde [m]
_DT, _SETTLE, _SAMPLES, _DRAWS = 0.01, 10_000, 100_000, 20
CENTERS = 0.05 * 2 ** (np.arange(22) / 3)
"""Of the third octaves [Hz]."""


def shaping(name, omega, speed, span, figures):
    """One-sided spectra over the angular frequency as the standard prints its filters, [unit^2 s/rad]."""
    length_u, length_w, sigma_u, sigma_w = figures
    s = 1j * omega
    t_u, t_w = length_u / speed, length_w / speed
    u = sigma_u * np.sqrt(2 * t_u / pi) / (1 + t_u * s)
    v = sigma_u * np.sqrt(t_u / pi) * (1 + np.sqrt(3) * t_u * s) / (1 + t_u * s) ** 2
    w = sigma_w * np.sqrt(t_w / pi) * (1 + np.sqrt(3) * t_w * s) / (1 + t_w * s) ** 2
    p = sigma_w * np.sqrt(0.8 / speed) * (pi / (4 * span)) ** (1 / 6) / length_w ** (1 / 3)
    filters = {
        "u": u,
        "v": v,
        "w": w,
        "p": p / (1 + 4 * span / (pi * speed) * s),
        "q": s / speed / (1 + 4 * span / (pi * speed) * s) * w,
        "r": s / speed / (1 + 3 * span / (pi * speed) * s) * v,
    }
    return np.abs(filters[name]) ** 2


def measure(height, speed):
    """Third octaves of the runs and of the standard (22, 6) [unit^2 s/rad], and the mean gusts (6,)."""
    figures = scales_and_intensities(height, 4)
    filters = GustFilters(SPAN)
    phi, noise = filters.make_step(figures[0], figures[1], speed * _DT)
    x, rng = np.zeros((_DRAWS, 8)), np.random.default_rng(5)
    states = np.empty((_SAMPLES, _DRAWS, 8))
    for k in range(-_SETTLE, _SAMPLES):
        x = x @ phi.T + rng.standard_normal((_DRAWS, 8)) @ noise.T
        states[k] = x
    draws = np.stack([filters.gusts(states[:, k], figures) for k in range(_DRAWS)])
    window = np.hanning(_SAMPLES)[:, None]
    power = np.mean([np.abs(np.fft.rfft(window * draw, axis=0)) ** 2 for draw in draws], axis=0)
    power *= _DT / (pi * (window**2).sum())  # over the angular frequency
    f = np.fft.rfftfreq(_SAMPLES, _DT)
    bands = [(f >= center * 2 ** (-1 / 6)) & (f < center * 2 ** (1 / 6)) for center in CENTERS]
    measured = np.array([power[band].mean(axis=0) for band in bands])
    expected = [
        [shaping(name, 2 * pi * f[band], speed, SPAN, figures).mean() for name in GUSTS] for band in bands
    ]
    return measured, np.array(expected), draws.mean(axis=(0, 1))


def draw():
    import matplotlib as mpl

    mpl.use("Agg")
    from matplotlib import pyplot

    height, speed = 60.0, 25.0
    measured, expected, _ = measure(height, speed)
    off = np.abs(measured / expected - 1)
    figure, axes = pyplot.subplots(1, 2, figsize=(10, 4), layout="constrained")
    f = np.geomspace(CENTERS[0], CENTERS[-1], 300)
    figures = scales_and_intensities(height, 4)
    for k, name in enumerate(GUSTS):
        color = tuple(tone / 255 for tone in SLOTS[k % 3].light)
        where = axes[k // 3]
        where.loglog(f, 2 * pi * shaping(name, 2 * pi * f, speed, SPAN, figures), color=color)
        label = f"{name}, within {off[:, k].max():.0%}"
        where.loglog(CENTERS, 2 * pi * measured[:, k], "o", ms=4, color=color, label=label)
    for where, title, unit in zip(axes, ("gusts", "rates of the air"), ("m/s", "rad/s"), strict=True):
        where.set(title=title, xlabel="frequency [Hz]", ylabel=f"power spectral density [({unit})²/Hz]")
        where.grid(visible=True, alpha=0.3)
        where.legend(title="third octaves of 20 runs; lines: MIL-F-8785C", fontsize=8, title_fontsize=8)
    figure.savefig(FOLDER / "gusts.png", dpi=100)
    print(f"{FOLDER / 'gusts.png'}: within {off.max():.1%}")


if __name__ == "__main__":
    draw()
