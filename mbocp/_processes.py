"""Processes of Python that run no module of the folder in which they are started.

`python -c` puts the current folder before the standard library: a `json.py` that lies there would be run.
"""

from __future__ import annotations

import json
import sys
from collections.abc import Mapping

# For processes that `multiprocessing` starts by commands of its own. Known since Python 3.11.
SAFE_PATH: Mapping[str, str] = {"PYTHONSAFEPATH": "1"}


def python_command(statements: str, *arguments: str) -> list[str]:
    """Words of a command that runs statements with the import path of this process.

    Parameters
    ----------
    statements : str
        Lines of Python; `sys` is imported.
    *arguments : str
        What stands in `sys.argv[1:]`.
    """
    path = json.dumps(sys.path)
    begin = "import sys, json\nsys.path[:] = json.loads(sys.argv.pop(1))\n"
    return [sys.executable, "-I", "-c", begin + statements, path, *arguments]
