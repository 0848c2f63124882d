"""IMUs that are made for a test: datasheets whose order is known."""

from __future__ import annotations

from pathlib import Path

FIGURES = """
[gyro]
noise_deg_sqrt_h = {a}
bias_instability_deg_h = {b}
bias_correlation_s = 300.0
turn_on_bias_sd_deg_h = {c}
[accel]
noise_m_s_sqrt_h = {d}
bias_instability_ug = {e}
bias_correlation_s = 300.0
turn_on_bias_sd_mg = {f}
"""


def write_unit(folder: Path, name: str, size: float, grade: str = "industrial", figures: str = "") -> str:
    """Write a datasheet and return its path: a size times figures of an industrial unit, or other figures."""
    head = f'title = "{name}"\nsource = "made"\n' + (f'class = "{grade}"\n' if grade else "")
    values = {"a": 0.2, "b": 8.0, "c": 100.0, "d": 0.03, "e": 60.0, "f": 3.0}
    scaled = {key: size * value for key, value in values.items()}
    path = folder / f"{name}.toml"
    path.write_text(head + (figures or FIGURES.format(**scaled)), encoding="utf-8")
    return str(path)
