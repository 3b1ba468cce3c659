"""The process that reads an old result file: stdin is the file, stdout the same content in today's format."""

from __future__ import annotations

import os
import resource
import sys

from mbocp.exceptions import ResultFileError
from mbocp.storage.guarded import REFUSED


def main(cpu_seconds: int, memory: int) -> None:
    """Read a file from stdin, and write a new one, or the reason why there is none, to stdout.

    Parameters
    ----------
    cpu_seconds, memory : int
        Limits, see `mbocp.storage.guarded.ReadLimits`.
    """
    _limit(resource.RLIMIT_CORE, 0)
    _limit(resource.RLIMIT_CPU, cpu_seconds)
    _limit(resource.RLIMIT_AS, memory)
    from mbocp.storage.hdf5 import content_of, image_of  # under the limits
    from mbocp.storage.seal import seal

    try:
        result = seal(image_of(content_of("-", sys.stdin.buffer.read(), is_sealed=False)))
    except ResultFileError as error:
        sys.stdout.buffer.write(error.reason.encode())
        sys.stdout.buffer.flush()
        os._exit(REFUSED)
    sys.stdout.buffer.write(result)
    sys.stdout.buffer.flush()
    os._exit(0)  # what libhdf5 has to say at its end is of no interest


def _limit(which: int, value: int) -> None:
    hard = resource.getrlimit(which)[1]
    value = value if hard == resource.RLIM_INFINITY else min(value, hard)
    resource.setrlimit(which, (value, hard))
