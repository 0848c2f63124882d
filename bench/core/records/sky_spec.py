"""Spec of GNSS at measurement level in SI and radians: constellations, reception, errors of the ranges."""

from __future__ import annotations

from collections.abc import Mapping
from datetime import date

from bench.core.records.fields import declared, figure
from bench.core.records.orbit_sets import GlonassSets, KeplerSets, parse_systems


@declared
class SkySpec:
    """Measurement-level GNSS: constellations, reception, errors of the ranges. 0 switches an error off."""

    day: date  # of the flight
    gps_t0: float  # GPS time of the start of the run, seconds since midnight of that day [s]
    orbits: Mapping[int, KeplerSets | GlonassSets] | None  # by system, since that midnight; others: nominal
    klobuchar: tuple[float, ...]  # (8,) true and broadcast ionosphere, alpha 0-3, beta 0-3
    systems: str  # that the receiver has, as `orbit_sets.parse_systems` takes it; "auto": GPS, GLONASS
    bands: int  # 1, or 2: the ionosphere-free combination
    elevation_mask: float = figure("deg", 3, 60)
    """Lowest elevation above the horizon that is used [rad]."""
    antenna_mask: float = figure("deg", -90, 60)
    """Lowest elevation above the plane of the antenna that is received [rad]."""
    cn0_zenith: float = figure("dbhz", 0, 70)
    """C/N0 along the axis of the antenna, up in the body [dB-Hz]."""
    cn0_horizon: float = figure("dbhz", 0, 70)
    """C/N0 in the plane of the antenna [dB-Hz]."""
    cn0_threshold: float = figure("dbhz", 0, 70)
    """Lowest C/N0 that is tracked [dB-Hz]."""
    second_band_loss: float = figure("db", default=0.0)
    """Loss of C/N0 of the second band against the first [dB]."""
    reacquisition: float = figure("s", default=0.0)
    """Time from the signal back to measurements back [s]."""
    dll_bandwidth: float = figure("hz", default=0.0)
    """Bandwidth of the code loop, which sets the noise of pseudoranges [Hz]."""
    dll_spacing: float = figure("chip", 0.01, 1, default=1.0)
    """Early to late spacing of the code loop [chip]."""
    fll_bandwidth: float = figure("hz", default=0.0)
    """Bandwidth of the frequency loop, which sets the noise of range rates [Hz]."""
    integration: float = figure("s", 1e-3, 1, default=0.02)
    """Integration before detection [s]."""
    gps_space_sd: float = figure("m", default=0.0)
    """Ephemeris and clock of GPS satellites, along the range [m]."""
    glonass_space_sd: float = figure("m", default=0.0)
    """Ephemeris and clock of GLONASS satellites, along the range [m]."""
    galileo_space_sd: float = figure("m", default=0.0)
    """Ephemeris and clock of Galileo satellites, along the range [m]."""
    beidou_space_sd: float = figure("m", default=0.0)
    """Ephemeris and clock of BeiDou satellites, along the range [m]."""
    space_correlation: float = figure("s", 1e-6, 1e9, default=0.0)
    """Correlation time of these [s]."""
    ionosphere_sd: float = figure("m", default=0.0)
    """Vertical delay that the broadcast model of the ionosphere leaves [m]."""
    ionosphere_share: float = figure("", 0, 1, default=0.0)
    """Additional error of the ionosphere model as a fraction of its delay [1]."""
    ionosphere_correlation: float = figure("s", 1e-6, 1e9, default=0.0)
    """Correlation time of both [s]."""
    ionosphere_decay: float = figure("km", 100, 1e5, default=3e6)
    """Distance in the ionosphere over which they lose all but 1/e of their correlation [m]."""
    troposphere_sd: float = figure("m", default=0.0)
    """Vertical delay that the model of the troposphere leaves [m]."""
    troposphere_correlation: float = figure("s", 1e-6, 1e9, default=0.0)
    """Correlation time of that [s]."""
    multipath_zenith_sd: float = figure("m", default=0.0)
    """Multipath at the zenith [m]."""
    multipath_horizon_sd: float = figure("m", default=0.0)
    """Multipath added at the horizon, 1/e of it at 10 deg [m]."""
    multipath_correlation: float = figure("s", 1e-6, 1e9, default=0.0)
    """Correlation time of the multipath [s]."""
    clock_offset_sd: float = figure("m", default=0.0)
    """Offset of the receiver clock at the start [m]."""
    clock_drift_sd: float = figure("mps", default=0.0)
    """Drift of the receiver clock at the start [m/s]."""
    glonass_offset_sd: float = figure("m", default=0.0)
    """GLONASS against GPS time in the receiver [m]."""
    galileo_offset_sd: float = figure("m", default=0.0)
    """Galileo against GPS time in the receiver [m]."""
    beidou_offset_sd: float = figure("m", default=0.0)
    """BeiDou against GPS time in the receiver [m]."""
    clock_h_0: float = figure("s", default=0.0)
    """White frequency noise of the clock, one-sided power-law coefficient [s]."""
    clock_h_m1: float = figure(default=0.0)
    """Flicker of its frequency [1]."""
    clock_h_m2: float = figure("hz", default=0.0)
    """Random walk of its frequency [1/s]."""
    clock_g: float = figure("ppb", -1e6, 1e6, default=0.0)
    """Change of its frequency with the specific force along body down; in a file, per g [s^2/m]."""
    false_alarm: float = figure("", 0, 0.5, default=1e-3)
    """Chance that the fault exclusion of an epoch raises a false alarm [1]."""

    @property
    def constellations(self) -> tuple[int, ...]:
        """Codes of the systems that the receiver has, in ascending order."""
        return tuple(sorted(parse_systems("both" if self.systems == "auto" else self.systems)))

    @property
    def space_sd(self) -> tuple[float, float, float, float]:
        """Error of ephemeris and clock by system [m]."""
        return self.gps_space_sd, self.glonass_space_sd, self.galileo_space_sd, self.beidou_space_sd

    @property
    def offset_sd(self) -> tuple[float, float, float, float]:
        """Time offset of each system relative to GPS in the receiver [m]."""
        return 0.0, self.glonass_offset_sd, self.galileo_offset_sd, self.beidou_offset_sd

    @property
    def ionosphere_left(self) -> bool:
        """Return whether ranges have an error of the ionosphere beyond the broadcast model."""
        return max(self.ionosphere_sd, self.ionosphere_share) > 0
