"""`mbocp menu`."""

from __future__ import annotations

import json

import mbocp


def test_the_command_prints_a_table_and_writes_what_is_asked_for(run, tmp_path):
    file, folder = "examples/arms/reach_pose.toml", tmp_path / "menu"
    words = ("menu", file, "--tries", "4", "--set", "horizon.steps=12", "--set", "integrator.scheme=se1")
    done = run(*words, "-o", str(folder), "--replay", str(tmp_path / "menu.html"))
    assert done.exit_code == 0, done.stderr
    assert "shoulder" in done.stdout
    assert "motions from 4 ways" in done.stdout
    assert "duration [s]" in done.stdout
    facts = json.loads(run(*words, "-o", str(folder), "--json").stdout)
    assert facts["tried"] == 4
    best = facts["choices"][0]
    assert mbocp.Solution.load(best["file"]).cost == best["cost"]
    file = tmp_path / "file"
    file.write_text("")
    refused = run(*words, "-o", str(file))
    assert refused.exit_code == 2
    assert "expected the name of a folder" in refused.stderr
