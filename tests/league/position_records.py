"""What the adapters of position filters share: fixes at the IMU sample that follows their arrival."""

import numpy as np

from bench.core.mathematics import earth


def causal_fixes(sensors):
    """Return IMU row, position (lla), velocity [m/s, n], and their variances (3,) of each usable fix.

    The package has no delay of fixes: a fix that arrives late is moved on by its own velocity, to the first
    IMU sample at or after its arrival.
    """
    fixes, t = sensors.fixes, sensors.imu.t
    row = np.searchsorted(t, fixes.t_arrival - 1e-9)
    sound = fixes.valid.astype(bool) & (row < len(t))
    sound &= np.isfinite(fixes.lla).all(axis=1) & np.isfinite(fixes.vel_n).all(axis=1)
    found = []
    for k in np.flatnonzero(sound):
        late = t[row[k]] - fixes.t[k]
        lla = earth.displace(fixes.lla[k], (late * fixes.vel_n[k])[None])[0]
        variances = (np.diag(one[k]) for one in (fixes.cov_pos_n, fixes.cov_vel_n))
        found.append((int(row[k]), lla, fixes.vel_n[k], *variances))
    return found


def bias_model(triad):
    """Return sd of the bias at the start, noise density and walk density of its bias, by the datasheet."""
    sd = triad.instability_sd
    walk = sd * np.sqrt(2.0 / triad.bias_correlation) if triad.bias_correlation else 0.0
    return float(np.hypot(triad.turn_on_bias_sd, sd)), float(triad.random_walk), float(walk)


def output_rows(sensors):
    """Return the IMU row of the last sample at or before each output time; -1: none yet."""
    return np.searchsorted(sensors.imu.t, sensors.output_t + 1e-9) - 1
