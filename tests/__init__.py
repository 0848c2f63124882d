"""Tests of bench; NumPy works with one thread, as the command line has it."""

import os

for _name in ("OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):  # before NumPy is loaded
    os.environ.setdefault(_name, "1")
