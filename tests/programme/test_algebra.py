"""The kernel's linear algebra on random systems against Eigen's: tests in C++."""

from __future__ import annotations

import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from mbocp.programme.processor import has_avx2

ROOT = Path(__file__).parents[2]
BUILD = ROOT / "build" / "kernel_tests"
TARGET = "kernel_tests_avx2" if has_avx2() else "kernel_tests"


@pytest.mark.skipif(shutil.which("c++") is None, reason="no C++ compiler")
def test_the_kernels_algebra_agrees_with_eigen() -> None:
    pytest.importorskip("cmake")
    pytest.importorskip("nanobind")
    cmake = [sys.executable, "-m", "cmake"]
    sources = [
        "-S",
        str(ROOT / "mbocp" / "_native"),
        "-B",
        str(BUILD),
        f"-DPython_EXECUTABLE={sys.executable}",
    ]
    ninja = ["-G", "Ninja", f"-DCMAKE_MAKE_PROGRAM={Path(sys.executable).parent / 'ninja'}"]
    for command in (
        [*cmake, "-B", str(BUILD), *sources, *ninja],
        [*cmake, "--build", str(BUILD), "--target", TARGET],
        [str(BUILD / TARGET)],
    ):
        done = subprocess.run(command, capture_output=True, text=True, check=False)
        assert done.returncode == 0, done.stdout + done.stderr
