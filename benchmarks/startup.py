"""How long commands take to start, beside the bare imports: `python -m benchmarks.startup [--docs]`.

Every command runs in a new process, in turn with `import numpy, casadi, pinocchio`: the best of several runs,
by the clock and in processor time, of which the ratios are. Compiled bytecode is there, as it is after the
first run of an installed package.
"""

from __future__ import annotations

import argparse
import os
import resource
import subprocess
import sys
import tempfile
import time
from collections.abc import Mapping, Sequence
from pathlib import Path

from benchmarks.machine import header
from benchmarks.tables import Table, present

__all__ = ["best_times", "commands"]

ROOT = Path(__file__).parents[1]
PROBLEM = ROOT / "examples" / "arms" / "ur5_reach.toml"
PAGE, BEGIN = ROOT / "benchmarks" / "measured" / "startup.md", "<!-- tables of benchmarks.startup -->"
BARE = "import numpy, casadi, pinocchio"
ASKED = {  # [s], and for a solve as a ratio
    "mbocp --help": "0.4 s",
    "import mbocp": "0.4 s",
    "mbocp info": "0.5 s",
    "mbocp plot": "2 s",
    "mbocp replay": "2 s",
    "mbocp check": "2 s",
    "mbocp solve": "1.3",
}


def commands(folder: Path) -> dict[str, list[str]]:
    """Arguments of Python for each row; the result that some of them read is in the folder."""
    shell, result = ["-m", "mbocp"], str(folder / "ur5.h5")
    return {
        BARE: ["-c", BARE],
        "mbocp --help": [*shell, "--help"],
        "import mbocp": ["-c", "import mbocp"],
        "mbocp info": [*shell, "info", result],
        "mbocp plot": [*shell, "plot", result, "-q", "-o", str(folder / "ur5.png")],
        "mbocp replay": [*shell, "replay", result, "-q", "-o", str(folder / "ur5.html")],
        "mbocp check": [*shell, "check", str(PROBLEM), "-q"],
        "mbocp solve": [*shell, "solve", str(PROBLEM)],
    }


def best_times(
    rows: Mapping[str, Sequence[str]], repeats: int, folder: Path
) -> dict[str, tuple[float, float]]:
    """Least time of each row by the clock and of the processor [s]; a round of all comes after the other."""
    environment = {key: value for key, value in os.environ.items() if key != "PYTHONDONTWRITEBYTECODE"}
    environment["PYTHONPYCACHEPREFIX"] = str(folder / "bytecode")
    best = dict.fromkeys(rows, (float("inf"), float("inf")))
    for turn in range(repeats + 1):
        for name, words in rows.items():
            begin, used = time.perf_counter(), _processor_time()
            subprocess.run(
                [sys.executable, *words], env=environment, cwd=ROOT, capture_output=True, check=True
            )
            if turn:  # the first compiles
                took = time.perf_counter() - begin, _processor_time() - used
                best[name] = (min(best[name][0], took[0]), min(best[name][1], took[1]))
    return best


def _processor_time() -> float:
    """Of all processes that have ended [s]."""
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    return used.ru_utime + used.ru_stime


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--repeats", type=int, default=7)
    parser.add_argument("--docs", action="store_true", help="put the tables into measured/startup.md")
    asked = parser.parse_args()
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        solve = [sys.executable, "-m", "mbocp", "solve", str(PROBLEM), "-q", "-o", str(folder / "ur5.h5")]
        subprocess.run(solve, check=True)
        best = best_times(commands(folder), asked.repeats, folder)
    bare = best[BARE][1]
    rows = [
        (f"`{name}`", f"{clock:.2f}", f"{used:.2f}", f"{used / bare:.2f}", ASKED.get(name, ""))
        for name, (clock, used) in best.items()
    ]
    names = ("what", "time [s]", "processor [s]", "ratio", "asked")
    times = Table("Start-up", names, rows)
    present([header(), times], PAGE, BEGIN, into_page=asked.docs)


if __name__ == "__main__":
    main()
