"""Benchmarks: `python -m benchmarks` (or `make bench`); every number on one core, with warm caches."""

import os

# Before NumPy loads: threads cost more than they gain on matrices of this size.
for _name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ.setdefault(_name, "1")
os.environ.setdefault("MBOCP_FUNCTIONS", "compiled")  # no compiler runs beside what is measured
