"""One solver on one problem: `python -m benchmarks.peers.tools.one TOOL TASK.json OUT.npz REPEATS`."""

from __future__ import annotations

import importlib
import json
import sys
from pathlib import Path

import numpy as np

from benchmarks.peers.task import load_task
from benchmarks.peers.tools.runs import NotSolved


def main() -> None:
    """Write the trajectory to OUT.npz, or OUT.json with the reason why there is none."""
    module, method = sys.argv[1].split(":")
    path, out, repeats = Path(sys.argv[2]), Path(sys.argv[3]), int(sys.argv[4])
    tool = importlib.import_module(f"benchmarks.peers.tools.{module}")
    try:
        run = tool.run(load_task(path), method, repeats)
    except NotSolved as error:
        out.with_suffix(".json").write_text(json.dumps({"reason": str(error)}))
        return
    np.savez(
        out,
        qs=run.qs,
        vs=run.vs,
        us=run.us,
        iterations=run.iterations,
        seconds=run.seconds,
        remark=run.remark,
    )


if __name__ == "__main__":
    main()
