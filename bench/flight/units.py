"""The units of JSBSim, exact."""

FT = 0.3048  # [m]
KT = 1852.0 / 3600.0  # [m/s]
PSF = 4.4482216152605 / FT**2  # pound force per square foot [Pa]
RANKINE = 5.0 / 9.0  # [K]
