"""The reader of DataFlash logs, as `bench.io.log_formats` asks for one."""

from __future__ import annotations

from pathlib import Path

from bench.io.logs.log_contents import OwnEstimate, OwnMotion
from bench.plugins.autopilots import flash_motion
from bench.plugins.autopilots.flash_rows import look as look
from bench.plugins.autopilots.flash_rows import open_log
from bench.plugins.autopilots.flash_rows import read as read


def read_truth(path: Path) -> OwnMotion:
    """Return the truth of a simulator in a log."""
    return flash_motion.read_truth(open_log(path))


def read_estimate(path: Path, instance: int | None) -> OwnEstimate:
    """Return the estimate of a core in a log; None: of the one that flew."""
    return flash_motion.read_estimate(open_log(path), instance)
