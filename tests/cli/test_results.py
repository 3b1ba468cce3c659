"""`mbocp replay`, `plot` and `info`."""

from __future__ import annotations

import dataclasses
import errno
import json
import os
import re
from pathlib import Path

import numpy as np
import pytest
from matplotlib.figure import Figure

import mbocp
import mbocp.view.of_solution
import mbocp.view.report
from mbocp.cli.solution_summary import print_rows
from mbocp.exceptions import LimitsExceeded
from mbocp.solution import Solution
from mbocp.solution.problem_facts import Facts, PathRow
from mbocp.solvers import Status
from tests.solution.fabricated import humanoid, limited, pendulum

from .conftest import Run


def test_info(result: Path, run: Run) -> None:
    done = run("info", str(result))
    assert done.exit_code == 0
    for words in ("arm", "ur5", "converged: all is well", "12.5", "mbocp 0.1.0"):
        assert words in done.stdout
    assert "limits" not in done.stdout
    assert "drift of rotations" not in done.stdout


@pytest.mark.parametrize("width", range(40, 56))
def test_no_line_breaks_between_a_number_and_its_unit(
    width: int, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv("COLUMNS", str(width))
    words = "wrist 3.5 N m and 12 kg m^2 at 31.9 rad/s, of 0.14 % in 3 ms, with 4 N m s"
    print_rows("arm", [("effort", words)])
    lines = capsys.readouterr().out.splitlines()[1:]
    assert len(lines) > 1
    assert max(map(len, lines)) <= width
    assert " ".join(" ".join(lines).split()) == f"effort {words}"
    assert not [line for line in lines if re.search(r"(\d|\bN|\bm|\bkg)$", line) and line is not lines[-1]]


def test_info_says_what_a_clearance_is_of(run: Run, tmp_path: Path, result: Path) -> None:
    near = {"clearance": 0.015, "clearance_between": "link and box", "clearance_time": 0.7}
    done = run("info", str(dataclasses.replace(Solution.load(result), **near).save(tmp_path / "near.h5")))
    words = "15 mm: link and box at 0.7 s, of the pairs that are checked, shape to shape"
    assert words in " ".join(done.stdout.split())


def test_info_says_that_limits_of_distances_are_those_of_spheres(folder: Path, run: Run) -> None:
    limited(path_names=("distance of hand[1] from box", "clearance")).save(folder / "near.h5")
    words = " ".join(run("info", "near.h5").stdout.split())
    assert "limits path" not in words
    assert "path distance of sphere hand[1] from box at its lower bound" in words


@pytest.mark.parametrize("command", ["plot", "replay"])
def test_a_robot_that_has_changed_since(folder: Path, run: Run, result: Path, command: str) -> None:
    other = mbocp.load_robot("double_pendulum")
    dataclasses.replace(Solution.load(result), robot_spec=dict(other.spec)).save(folder / "other.h5")
    done = run(command, "other.h5")
    assert done.exit_code == 2
    assert "is about another robot 'ur5' than there is now: it has nq = 6 and nv = 6" in done.stderr


def test_a_motion_too_far_away_to_be_drawn(folder: Path, run: Run, result: Path) -> None:
    solution = Solution.load(result)
    dataclasses.replace(solution, qs=solution.qs + 1e300).save(folder / "far.h5")
    done = run("replay", "far.h5")
    assert done.exit_code == 2
    assert "expected numbers up to 1e+09" in done.stderr


def test_results_of_one_name_are_told_apart(
    folder: Path, run: Run, result: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    seen: list[str] = []
    monkeypatch.setattr(mbocp.view.report, "compare_results", lambda results, path: seen.extend(results))
    assert run("report", str(result), str(result), "-o", "both.html").exit_code == 0
    assert seen == [f"{result} (1)", f"{result} (2)"]
    Solution.load(result).save(folder / "other.h5")
    assert run("report", str(result), "other.h5", "-o", "both.html").exit_code == 0
    assert seen[2:] == [result.stem, "other"]


@pytest.mark.parametrize("command", ["plot", "replay"])
def test_a_motion_that_is_none_cannot_be_drawn(folder: Path, run: Run, command: str) -> None:
    """The line names the file."""
    spec = dict(mbocp.load_robot("rigid_pendulum").spec)
    nothing = np.full((101, 3), np.nan)
    made = pendulum(status="diverged", qs=nothing, robot_spec=spec, problem_text="")
    made.save(folder / "diverged.h5")
    done = run(command, "diverged.h5")
    assert done.exit_code == 2
    words = " ".join(done.stderr.split())
    assert words.startswith("error: diverged.h5: cannot be drawn: ")
    assert "expected" in words
    assert [path.suffix for path in folder.iterdir() if "diverged" in path.name] == [".h5"]


@pytest.mark.filterwarnings("ignore::mbocp.robot.RobotNotStoredWarning")
@pytest.mark.parametrize("command", ["plot", "replay"])
def test_a_robot_that_is_gone(folder: Path, run: Run, command: str) -> None:
    pendulum(robot_spec={"name": "elsewhere/robot.toml"}).save(folder / "lonely.h5")
    done = run(command, "lonely.h5")
    assert done.exit_code == 2
    assert " ".join(done.stderr.split()).startswith("error: lonely.h5: its robot cannot be loaded: ")


@pytest.mark.parametrize(
    ("words", "name"),
    [
        ("plot arm.h5", "arm.png"),
        ("replay arm.h5", "arm.html"),
        ("report arm.h5 -o page.html", "page.html"),
        ("new rigid_pendulum --force -o first.toml", "first.toml"),
        ("schema -o keys.json", "keys.json"),
    ],
)
@pytest.mark.usefixtures("result")
def test_a_full_disk(folder: Path, run: Run, monkeypatch: pytest.MonkeyPatch, words: str, name: str) -> None:
    def refuse(_: Path) -> None:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    old = folder / name
    old.write_text("old")
    monkeypatch.setattr("mbocp.solution.atomic._flush", refuse)
    monkeypatch.setattr("mbocp.view.plots.overview", lambda *_, **__: Figure())  # whatever is on the page
    done = run(*words.split())
    assert (done.exit_code, done.stdout, old.read_text()) == (2, "", "old")
    assert re.match(f"error: (.*/)?{name}: cannot be written: No space left on device", done.stderr)


def test_info_of_a_result_with_limits(folder: Path, run: Run) -> None:
    limited().save(folder / "limited.h5")
    words = " ".join(run("info", "limited.h5").stdout.split())
    assert "by scheme rk4, 2 steps in each guess" in words  # a particle does not turn
    assert re.search(r"limits control force_x at its upper limit 25 N in \d+ of 20 steps", words)
    assert "path ceiling.z at its lower bound in 3 of 20 nodes" in words
    assert "violated by 1.00e-09 at most" in words
    assert "drift of rotations" not in words
    facts = json.loads(run("info", "limited.h5", "--json").stdout)
    assert (facts["manifold_drift"], facts["manifold_drift_resimulated"]) == (3e-9, 1e-15)
    assert facts["limit_violation"] == 1e-9


def test_info_counts_the_constraints_of_the_robot_and_not_those_of_its_bodies(folder: Path, run: Run) -> None:
    words = {"scheme": "midpoint", "coordinates": "natural", "goal": {"q": {"crank": 1.5}, "v": 0}}
    problem = mbocp.Problem.create("four_bar", 0.5, 8, start={"q": {"crank": 1.0}}, **words)
    mbocp.solve(problem, check=True).save(folder / "four_bar.h5")
    told = " ".join(run("info", "four_bar.h5").stdout.split())
    assert "four_bar: 1 degree of freedom (3 velocities, 2 constraints)" in told
    assert re.search(r"goal off by \S+ rad at crank, velocity by \S+ rad/s at rocker", told)


def test_info_says_how_rotations_are_kept(folder: Path, run: Run) -> None:
    how = {"scheme": "rk4", "lie": "baumgarte", "rotations": "dcm"}
    drift = {"manifold_drifts": np.full(101, 3e-9), "manifold_drift_resimulated": 1e-15}
    humanoid(**how, **drift).save(folder / "dcm.h5")
    words = " ".join(run("info", "dcm.h5").stdout.split())
    assert "by scheme rk4; rotations: dcm, baumgarte" in words
    assert "drift of rotations 3.00e-09 at most; 1.00e-15 when simulated with the controls" in words
    humanoid().save(folder / "unknown.h5")  # nobody has looked
    assert "drift of rotations" not in run("info", "unknown.h5").stdout


def test_info_of_a_result_whose_limits_are_far(folder: Path, run: Run) -> None:
    nothing = {"us": np.zeros((20, 3)), "vs": np.zeros((21, 3)), "lam_path": np.zeros((20, 2))}
    limited(**nothing, manifold_drifts=np.zeros(0)).save(folder / "free.h5")
    words = " ".join(run("info", "free.h5").stdout.split())
    assert "limits none is active violated by 1.00e-09 at most" in words
    assert "drift of rotations" not in words


def test_round_off_violates_no_limit(folder: Path, run: Run) -> None:
    limited(limit_violation=4e-15).save(folder / "kept.h5")
    words = run("info", "kept.h5").stdout
    assert "all are kept at the nodes" in words
    assert "violated by 4.00e-15" not in words


@pytest.mark.parametrize(("violation", "is_told"), [(4e-15, False), (0.1, True)])
def test_via_points_are_no_limits(folder: Path, run: Run, violation: float, is_told: bool) -> None:
    rows = (PathRow("1: hand.x", 0.0, 0.0, "m", 1), PathRow("1: side 0", 0.0, np.inf, "", 1))
    words = {"path_names": tuple(row.name for row in rows), "facts_kept": Facts(path=rows)}
    free = pendulum(lam_path=np.zeros((100, 2)), limit_violation=violation, **words)
    free.save(folder / "via.h5")
    assert ("limits" in run("info", "via.h5").stdout) is is_told


def test_no_more_limits_than_one_reads(folder: Path, run: Run) -> None:
    names = tuple(f"wall {i}" for i in range(12))
    limited(lam_path=np.ones((20, 12)), path_names=names).save(folder / "many.h5")
    words = run("info", "many.h5").stdout
    assert "more" in words
    assert "wall 11" not in words


def test_info_json_is_that_of_solve(result: Path, run: Run) -> None:
    facts = json.loads(run("info", str(result), "--json").stdout)
    assert (facts["status"], facts["cost"]) == ("converged", 12.5)


def test_replay_beside_the_result(result: Path, run: Run) -> None:
    done = run("replay", str(result))
    assert done.exit_code == 0
    page = result.with_suffix(".html")
    assert str(page) in done.stdout
    assert "<html" in page.read_text(encoding="utf-8")[:500].lower()


def test_replay_live(result: Path, run: Run, monkeypatch: pytest.MonkeyPatch) -> None:
    calls = []
    monkeypatch.setattr(mbocp.view.of_solution, "open_replay", lambda *a, **k: calls.append(k))
    done = run("replay", str(result), "--open", "--trace", "tool0", "--speed", "0.5")
    assert done.exit_code == 0
    marks = calls[0].pop("marks")
    assert (marks.via, marks.lines) == ((), ())
    nothing = {"goals": [], "other_goals": [], "ghosts": [], "others": [], "direction": None}
    assert calls == [{"trace": ["tool0"], "title": "arm", "speed": 0.5, **nothing}]
    assert not result.with_suffix(".html").exists()


def test_plot(result: Path, run: Run) -> None:
    done = run("plot", str(result), "-o", "arm.svg")
    assert done.exit_code == 0
    assert Path("arm.svg").stat().st_size > 1000


@pytest.mark.parametrize(
    ("arguments", "reason"),
    [
        (["info", "missing.h5"], "missing.h5: no such file"),
        (["info", "arm.toml"], "arm.toml: is not a result file"),
        (["replay", "arm.h5", "--trace", "tool"], "no frame 'tool'"),
        (["replay", "arm.h5", "--speed", "0"], "--speed: got 0"),
        (["replay", "arm.h5", "-o", "nowhere/a.html"], "there is no folder 'nowhere'"),
        (["plot", "arm.h5", "-o", "a.bmp"], "-o must end in .png or .pdf or .svg"),
        (["plot", "missing.h5"], "missing.h5: no such file"),
    ],
)
def test_bad_input_is_2(result: Path, run: Run, arguments: list[str], reason: str) -> None:
    done = run(*arguments)
    assert done.exit_code == 2
    assert reason in done.stderr
    assert done.stdout == ""


def test_a_motion_is_exported(run, tmp_path, result):
    target = tmp_path / "motion.csv"
    done = run("export", str(result), "-o", str(target), "--rate", "100")
    assert done.exit_code == 0, done.stderr
    assert target.read_text().startswith("t [s],q:")
    assert "points at" not in done.stdout
    done = run("export", str(result), "-o", str(tmp_path / "motion.xls"))
    assert done.exit_code == 2
    assert "got '.xls', expected a suffix that says it: .csv (csv), .yaml (ros2)" in done.stderr
    done = run("export", str(result), "-o", str(tmp_path / "motion.gif"))
    assert done.exit_code == 2
    assert "`mbocp replay RESULT --movie motion.gif` films a motion" in done.stderr


def test_points_beside_the_rate_are_told(run, tmp_path, result):
    target = tmp_path / "motion.yaml"
    done = run("export", str(result), "-o", str(target), "--rate", "73")
    stamps = [
        int(sec) + 1e-9 * int(nanosec)
        for sec, nanosec in re.findall(r"sec: (\d+), nanosec: (\d+)", target.read_text())
    ]
    others = sum(abs(73.0 * t - round(73.0 * t)) > 1e-6 for t in stamps[:-1])
    assert others > 0
    told = f"{len(stamps) - others} points at 73 Hz, {others} where polynomials meet"
    assert told in " ".join(done.stdout.split())


def test_export_checks_limits_unless_it_is_asked_not_to(run, tmp_path, result):
    solution = Solution.load(result)
    slower = np.abs(solution.vs).max(axis=0) * np.array([[-0.5], [0.5]])
    fast = dataclasses.replace(solution, limits_v=slower).save(tmp_path / "fast.h5")
    target = tmp_path / "motion.csv"
    assert run("export", str(result), "-o", str(target)).exit_code == 0
    assert run("export", str(fast), "-o", str(target), "--no-check").exit_code == 0
    target.unlink()
    done = run("export", str(fast), "-o", str(target))
    assert done.exit_code == 1
    assert not target.exists()
    told = [line for line in done.stderr.splitlines() if "leaves its limits: speed" in line]
    assert len(told) == solution.nv
    assert "not written: say the controller's rate, --rate 1000 for one" in done.stderr
    done = run("export", str(fast), "-o", str(target), "--rate", "100")
    assert f"{target}: not written: take more steps; --no-check writes it" in done.stderr


def test_more_steps_do_not_help_what_is_no_solution(run, tmp_path, result):
    solution = Solution.load(result)
    slower = np.abs(solution.vs).max(axis=0) * np.array([[-0.5], [0.5]])
    failed = dataclasses.replace(solution, limits_v=slower, status=Status.INFEASIBLE)
    target, file = tmp_path / "motion.csv", failed.save(tmp_path / "failed.h5")
    done = run("export", str(file), "-o", str(target))
    assert done.exit_code == 1
    assert f"the solve did not converge; `mbocp explain {file}` says why; --no-check writes it" in done.stderr
    with pytest.raises(LimitsExceeded, match="did not converge"):
        failed.export(target)


@pytest.mark.parametrize(("suffix", "default"), [("yaml", "quintics"), ("csv", "cubics")])
def test_export_says_what_is_between_the_nodes(run, tmp_path, result, suffix, default):
    target = tmp_path / f"motion.{suffix}"
    done = run("export", str(result), "-o", str(target))
    words = " ".join(done.stdout.split())
    assert re.search(
        rf"{default} over 1 s, accelerations at its ends up to \S+ rad/s\^2 and \S+ rad/s\^2$", words
    )
    other = {"quintics": "cubic", "cubics": "quintic"}[default]
    before = target.read_text()
    assert run("export", str(result), "-o", str(target), "--interpolation", other).exit_code == 0
    assert target.read_text() != before
    assert run("export", str(result), "-o", str(target), "--interpolation", "septic").exit_code == 2


def test_brackets_and_colons_are_printed_as_they_are(capsys: pytest.CaptureFixture[str]) -> None:
    """Rich would take them for markup and for names of pictures."""
    print_rows("title", [("result", "runs[b]/:robot:.h5"), ("[i]", "x")])
    shown = capsys.readouterr().out
    assert "runs[b]/:robot:.h5" in shown
    assert "[i]" in shown
