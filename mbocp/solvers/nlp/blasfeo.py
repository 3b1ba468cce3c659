"""BLASFEO, the linear algebra below fatrop, with kernels for the processor at hand.

CasADi's wheels carry BLASFEO as compiled for any x86-64 processor, which takes twice the time of one for
AVX2 over a factorisation. Its three innermost kernels are replaced in this process, once each has been
compared with the library's own.
"""

from __future__ import annotations

from functools import cache
from pathlib import Path

import casadi as ca

from mbocp.solvers.native import nlp_helpers
from mbocp.transcription.compilation import has_avx2

__all__ = ["accelerate_blasfeo"]


@cache
def accelerate_blasfeo() -> tuple[str, ...]:
    """Replace BLASFEO's kernels where that helps, once a process.

    Returns
    -------
    replaced : tuple of str
        Names of the kernels; empty where the processor has no AVX2, or CasADi came without BLASFEO.
    """
    library = Path(ca.__file__).parent / "libblasfeo.so.0"
    if not has_avx2() or not library.is_file():
        return ()
    return tuple(nlp_helpers().accelerate_blasfeo(str(library)))
