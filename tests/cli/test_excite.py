"""`mbocp excite`."""

from __future__ import annotations

import json

import pytest

import mbocp
from mbocp.exceptions import MbocpError
from mbocp.problem.file.tables import write_tables
from mbocp.problem.problem import problem_from_tables
from mbocp.solving import to_excite

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


def test_solving_a_file_that_asks_for_it_finds_the_same(run, tmp_path):
    file = tmp_path / "swing.toml"
    file.write_text(
        FILE + "[goal.excite]\ntorque_noise = 0.02\nfriction = 'viscous'\nstarts = 1\nrounds = 5\n"
    )
    facts = json.loads(run("excite", str(file), "--json").stdout)
    solution = mbocp.solve(file)
    told = mbocp.identification.information(solution, torque_noise=0.02, friction="viscous")
    assert facts["log_det"] == pytest.approx(told.log_det)
    assert solution.problem.excite is None  # near a spline that was found: its iterate is of that problem
    asked = mbocp.load_problem(file)
    assert problem_from_tables(write_tables(asked)).excite.rounds == 5
    assert to_excite(asked, {"starts": 2}).excite.rounds == 5
    with pytest.raises(MbocpError, match=r"goal\.excite\.friction: got 'dry'"):
        asked.with_(goal={"excite": {"friction": "dry"}})
    with pytest.raises(MbocpError, match=r"goal\.excite: an exciting motion has one goal"):
        mbocp.excite(asked.with_(goal={"any": [{"q": [0.1, 0.0]}, {"q": [0.2, 0.0]}]}))
    with pytest.raises(MbocpError, match=r"goal\.excite"):
        mbocp.RecedingHorizon(asked)
