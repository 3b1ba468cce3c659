"""What the processor can do, as far as compiled functions and the kernel use it."""

from __future__ import annotations

import platform
from functools import cache
from pathlib import Path

from mbocp._environment import number_from
from mbocp.exceptions import InvalidValue

_NEEDED = {4: frozenset({"avx2", "fma"}), 8: frozenset({"avx2", "fma", "avx512f", "avx512dq", "avx512vl"})}
_WIDTHS = (1, 4, 8)  # doubles of a vector register that functions are written for


def _features() -> frozenset[str]:
    """Names of what the processor has; told by Linux alone."""
    return _features_of(platform.machine())


@cache
def _features_of(machine: str) -> frozenset[str]:
    if machine not in ("x86_64", "AMD64"):  # an emulated program reads of the processor beneath it
        return frozenset()
    try:
        text = Path("/proc/cpuinfo").read_text(encoding="ascii", errors="replace")
    except OSError:
        return frozenset()
    return frozenset(next((line for line in text.splitlines() if line.startswith("flags")), "").split())


def has_avx2() -> bool:
    """Whether the processor has AVX2 and fused multiplication and addition."""
    return _features() >= _NEEDED[4]


def number_of_lanes() -> int:
    """At how many stages functions are called at once: 8 with AVX-512, 4 with AVX2, else 1.

    $MBOCP_LANES takes another of these numbers; without AVX2 it is always 1.

    Raises
    ------
    InvalidValue
        If that is set to another number.
    """
    expected = f"one of the numbers {', '.join(map(str, _WIDTHS))}"
    named = number_from("MBOCP_LANES", expected)
    if named is not None and named not in _WIDTHS:
        raise InvalidValue("MBOCP_LANES", str(named), expected)
    if not has_avx2():
        return 1
    return int(named) if named is not None else 8 if _features() >= _NEEDED[8] else 4


def instruction_flags() -> tuple[str, ...]:
    """Options of a C compiler for the instructions that the processor has: a fifth less time, and lanes."""
    if not has_avx2():
        return ()
    wide = ("-mavx512f", "-mavx512dq", "-mavx512vl", "-mprefer-vector-width=512")
    return ("-mavx2", "-mfma", *(wide if number_of_lanes() == 8 and _features() >= _NEEDED[8] else ()))
