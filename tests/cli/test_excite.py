"""`mbocp excite`."""

from __future__ import annotations

import json

import mbocp

FILE = """
robot = "double_pendulum"
[horizon]
duration = 2.0
steps = 40
[start]
q = [0, 0]
[goal]
q = [0, 0]
v = 0
[limits]
velocity = 3.0
acceleration = 15.0
"""


def test_the_command_prints_what_is_told_and_saves_the_motion(run, tmp_path):
    file, result = tmp_path / "swing.toml", tmp_path / "swing.h5"
    file.write_text(FILE)
    done = run("excite", str(file), "--starts", "1", "-o", str(result))
    assert done.exit_code == 0, done.stderr
    assert "log det" in done.stdout
    assert "damping" in done.stdout
    assert mbocp.Solution.load(result).converged
    facts = json.loads(run("excite", str(file), "--starts", "1", "--json").stdout)
    told = mbocp.identification.information(mbocp.Solution.load(result))
    assert abs(facts["log_det"] - told.log_det) < 1e-6
    assert list(facts["sd"]) == list(told.base.names)
    refused = run("excite", str(file), "-o", str(tmp_path / "swing.csv"))
    assert refused.exit_code == 2
    assert ".h5" in refused.stderr
