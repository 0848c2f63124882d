"""IMU noise parameters of other programs: datasheets into their files and back."""

from bench.io.parameters.conversion import (
    Converted,
    bound_tuning,
    list_missing,
    read_parameters,
    write_parameters,
)
from bench.io.parameters.measured_sheet import (
    format_measured_sheet,
    make_measured_spec,
    summarize_fit,
    summarize_poses,
)
from bench.io.parameters.programs import PROGRAMS, TUNINGS
from bench.io.parameters.sheet_text import format_sheet

__all__ = [
    "PROGRAMS",
    "TUNINGS",
    "Converted",
    "bound_tuning",
    "format_measured_sheet",
    "format_sheet",
    "list_missing",
    "make_measured_spec",
    "read_parameters",
    "summarize_fit",
    "summarize_poses",
    "write_parameters",
]
