"""The units of JSBSim, exact."""

import math

FT = 0.3048  # [m]
INCH = 0.0254  # [m]
KT = 1852.0 / 3600.0  # [m/s]
POUND = 0.45359237  # of mass [kg]
SLUG = 4.4482216152605 / FT  # [kg]
PSF = 4.4482216152605 / FT**2  # pound force per square foot [Pa]
RANKINE = 5.0 / 9.0  # [K]
RPM = math.pi / 30.0  # [rad/s]
