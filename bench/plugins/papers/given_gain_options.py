"""Options of the filters with a gain that does not follow from a covariance."""

from __future__ import annotations

from bench.navigation.options import ClassicOptions, Positive


class ComplementaryOptions(ClassicOptions):
    """Options of the complementary filter."""

    time_constant: Positive = 10.0
    """Below 1 / time_constant GNSS and barometer are followed, above it the INS [s]."""


class LeastSquaresOptions(ClassicOptions):
    """Options of least squares over the past."""

    memory: Positive = 60.0
    """Age at which a measurement weighs 1/e of a new one [s]."""
