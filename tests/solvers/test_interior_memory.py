"""Interior-point solvers keep their functions between runs, and not the memory of their last run."""

from __future__ import annotations

import ctypes
import gc
import sys
from pathlib import Path

import pytest

import mbocp

pytestmark = [
    pytest.mark.skipif(sys.platform != "linux", reason="mallinfo2 is glibc's"),
]

FILE = Path(__file__).parents[2] / "examples" / "paper" / "elastic_pendulum.toml"


class _MallInfo2(ctypes.Structure):
    _names = "arena ordblks smblks hblks hblkhd usmblks fsmblks uordblks fordblks keepcost"
    _fields_ = [(name, ctypes.c_size_t) for name in _names.split()]


def memory_in_use() -> float:
    """What native code holds [MB], without what the allocator keeps free."""
    gc.collect()
    mallinfo2 = ctypes.CDLL(None).mallinfo2
    mallinfo2.restype = _MallInfo2
    return (mallinfo2().uordblks + mallinfo2().hblkhd) / 1e6


def solved(steps: int) -> mbocp.Solution:
    settings = [f"horizon.steps={steps}", "limits={effort=5.83}"]
    return mbocp.solve(mbocp.load_problem(FILE, settings), solver="ipopt")


def test_a_run_of_ipopt_leaves_its_functions_alone() -> None:
    """0.8 MB at this size; with the factorisation of the last run it would be 7 MB."""
    solved(20)  # loads IPOPT
    before = memory_in_use()
    assert solved(150).converged
    assert memory_in_use() - before < 2.0
