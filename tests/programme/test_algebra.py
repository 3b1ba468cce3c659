"""The kernel's linear algebra on random systems against Eigen's: tests in C++."""

from __future__ import annotations

import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from mbocp.programme.native_modules import has_avx2

ROOT = Path(__file__).parents[2]
TARGET = "kernel_tests_avx2" if has_avx2() else "kernel_tests"


def build_folder() -> Path:
    """Of the development install, whose objects are those of the kernel that is loaded."""
    tag = f"cp{sys.version_info.major}{sys.version_info.minor}"
    caches = list((ROOT / "build").glob(f"{tag}-{tag}-*/CMakeCache.txt"))
    if not caches:
        pytest.skip("no development install")
    return caches[0].parent


@pytest.mark.skipif(shutil.which("c++") is None, reason="no C++ compiler")
def test_the_kernels_algebra_agrees_with_eigen() -> None:
    pytest.importorskip("cmake")
    pytest.importorskip("nanobind")
    build = build_folder()
    for command in (
        [sys.executable, "-m", "cmake", "--build", str(build), "--target", TARGET],
        [str(build / TARGET)],
    ):
        done = subprocess.run(command, capture_output=True, text=True, check=False)
        assert done.returncode == 0, done.stdout + done.stderr
