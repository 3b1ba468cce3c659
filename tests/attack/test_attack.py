"""The attack's short form; and what it is worth: whether it is the same twice, and sees what it looks for."""

from __future__ import annotations

import json
import math
import os
import re
import subprocess
import sys
import time
import warnings
from collections import Counter
from collections.abc import Callable
from dataclasses import asdict
from pathlib import Path
from random import Random

import pytest
import yaml

from .cases import KINDS, Case, make_case, mutate_file
from .corpus import ROOT, entries
from .guided import guided
from .report import Tally, shares
from .runner import LIMITS, Limits, Outcome, attack, throw
from .targets import TARGETS
from .yamls import count_entries

COUNT = 2000
NAMES_A_FILE = re.compile(rb'"[^"\n]*(/|\.[a-z]{3,4}")')


@pytest.mark.parametrize("count", [60, pytest.param(COUNT, marks=pytest.mark.slow)])
def test_nothing_is_lost(count: int) -> None:
    """Any finding is told with the command that replays it."""
    command = [sys.executable, "-m", "tests.attack", "--count", str(count), "--short", "--quiet"]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False)
    assert done.returncode == 0, f"{done.stdout}\n{done.stderr[-2000:]}"
    assert f"| all | {count} |" in done.stdout


@pytest.mark.parametrize("kind", KINDS)
def test_a_seed_makes_the_same_input_again(kind: str) -> None:
    cases = [make_case(kind, seed) for seed in range(20)]
    again = [make_case(kind, seed) for seed in range(20)]
    assert [case.files for case in cases] == [case.files for case in again]
    changed = [case for case in cases if case.files != case.originals]
    assert len(changed) > 15
    assert len({tuple(sorted(case.files.items())) for case in changed}) > 10


@pytest.mark.parametrize("kind", [kind for kind in KINDS if kind not in ("solve", "command")])
@pytest.mark.filterwarnings("ignore")
def test_files_that_nobody_touched_are_accepted(kind: str, tmp_path: Path) -> None:
    for number, entry in enumerate(dict.fromkeys(entries(kind))):
        if kind == "problem" and not NAMES_A_FILE.search(entry.files[entry.main]):
            continue  # it is the same in every folder, and tests/frozen loads it
        folder = tmp_path / str(number)
        folder.mkdir()
        case = Case(kind, 0, entry.name, entry.main, entry.files, entry.files)
        TARGETS[kind](case, case.write(folder))


def _input(kind: str, seed: int) -> Case:
    return Case(kind, seed, "", "x", {"x": b""}, {})


def _run(action: Callable[[], object], monkeypatch: pytest.MonkeyPatch, limits: Limits = LIMITS) -> Outcome:
    """Throw three inputs of which the second does this; its outcome."""
    monkeypatch.setitem(TARGETS, "urdf", lambda case, path: action() if case.seed == 1 else None)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", DeprecationWarning)  # Python 3.12: a fork where threads may be
        outcomes = list(attack(iter([("urdf", 0), ("urdf", 1), ("urdf", 2)]), 1, limits=limits, make=_input))
    assert sorted(outcome.seed for outcome in outcomes) == [0, 1, 2]
    assert [outcome.verdict for outcome in outcomes if outcome.seed != 1] == ["accepted", "accepted"]
    return next(outcome for outcome in outcomes if outcome.seed == 1)


def _spin() -> None:
    while True:
        pass


def _fail() -> None:
    raise KeyError("x")


FINDINGS: dict[str, Callable[[], object]] = {
    "crash": os.abort,
    "hang": _spin,
    "traceback": _fail,
    "noise": lambda: os.write(2, b"Exception ignored\n"),
    "foreign warning": lambda: warnings.warn("overflow encountered", RuntimeWarning, stacklevel=1),
    "long message": lambda: warnings.warn("x" * 10_000, UserWarning, stacklevel=1),
    "memory": lambda: bytearray(os.urandom(1 << 20) * 100),
}


@pytest.mark.parametrize("verdict", FINDINGS)
def test_what_is_lost_is_seen(verdict: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """And costs one input: the others are thrown all the same."""
    limits = Limits(cpu=0.5, wall=20.0, memory=50 << 20)
    outcome = _run(FINDINGS[verdict], monkeypatch, limits)
    assert outcome.verdict == verdict
    assert outcome.is_finding


def test_what_sleeps_is_killed(monkeypatch: pytest.MonkeyPatch) -> None:
    assert _run(lambda: time.sleep(60), monkeypatch, Limits(wall=0.5)).verdict == "hang"


def test_memory_that_is_not_there_is_an_error(monkeypatch: pytest.MonkeyPatch) -> None:
    outcome = _run(lambda: bytearray(1 << 45), monkeypatch)
    assert (outcome.verdict, outcome.text[:11]) == ("traceback", "MemoryError")


def test_what_coverage_guides_is_told_one_by_one(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """Verdicts, times and findings are those of the inputs; a search that throws nothing is a finding."""
    told = [
        {"verdict": "accepted", "seconds": 0.5, "input": ""},
        {"verdict": "refused", "where": "RobotError", "input": ""},
        {"verdict": "traceback", "where": "KeyError", "input": "urdf-1.input"},
    ]

    def search(command: list[str], **_: object) -> subprocess.CompletedProcess[str]:
        kind, log = command[4], Path(command[-1])
        rows = told if kind == "urdf" else []
        lines = [json.dumps({**asdict(Outcome(kind, i, "")), **row}) for i, row in enumerate(rows)]
        (log / f"{kind}.jsonl").write_text("".join(line + "\n" for line in lines))
        return subprocess.CompletedProcess(command, 0, "#1 INITED cov: 10 ft: 1\n#3 DONE   cov: 25 ft: 2\n")

    monkeypatch.setattr(subprocess, "run", search)
    outcomes = list(guided(6, 1, tmp_path))
    found = [outcome for outcome in outcomes if outcome.kind == "urdf, guided"]
    assert [outcome.verdict for outcome in found] == ["accepted", "refused", "traceback"]
    assert found[0].seconds == 0.5
    assert found[2].where == "KeyError in urdf-1.input"
    others = [outcome for outcome in outcomes if outcome not in found]
    assert {outcome.where for outcome in others} == {"atheris threw nothing"}
    assert "urdf: 3 inputs, 10 to 25 edges" in capsys.readouterr().err


def test_a_search_that_an_input_ends_begins_anew(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The finding is one input of those that were asked for; the others are thrown all the same."""
    seeds: list[int] = []

    def search(command: list[str], **_: object) -> subprocess.CompletedProcess[str]:
        kind, count, log = command[4], int(command[6]), Path(command[-1])
        seeds.append(int(command[8]))
        is_lost = count == 10
        rows = [{**asdict(Outcome(kind, i, "refused")), "input": ""} for i in range(4 if is_lost else count)]
        (log / f"{kind}.jsonl").write_text("".join(json.dumps(row) + "\n" for row in rows))
        return subprocess.CompletedProcess(command, 77 if is_lost else 0, "")

    monkeypatch.setattr(subprocess, "run", search)
    monkeypatch.setattr("tests.attack.guided.GUIDED", ("urdf",))
    verdicts = Counter(outcome.verdict for outcome in guided(10, 1, tmp_path, seed=7))
    assert verdicts == {"refused": 9, "crash": 1}
    assert len(seeds) == len(set(seeds)) == 2
    assert seeds[0] == 7


@pytest.mark.slow
def test_coverage_guides_to_results_and_refusals(tmp_path: Path) -> None:
    """Inputs are mutated and thrown: most kinds are refused now and then, and lines are reached."""
    pytest.importorskip("atheris")
    command = [sys.executable, "-m", "tests.attack.coverage", "--kind", "robot_toml", "--count", "120"]
    done = subprocess.run(
        [*command, "--log", str(tmp_path)], cwd=ROOT, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr[-2000:]
    rows = [json.loads(line) for line in (tmp_path / "robot_toml.jsonl").read_text().splitlines()]
    assert len(rows) >= 120
    assert {"accepted", "refused"} <= {row["verdict"] for row in rows}
    assert len({row["text"] for row in rows}) > 20


def test_an_alias_bomb_is_mutated_as_a_text() -> None:
    """As a tree it has 9^12 entries, and took the memory of the process that mutates what it has mutated."""
    lines = ["b0: &b0 [x, x, x, x, x, x, x, x, x]"]
    lines += [f"b{i}: &b{i} [{', '.join([f'*b{i - 1}'] * 9)}]" for i in range(1, 12)]
    bomb = "\n".join([*lines, "closed_loop: *b11"]).encode()
    assert count_entries(yaml.safe_load(bomb)) > 9**12
    assert count_entries(yaml.safe_load("a: &a [*a]")) == math.inf
    mutated = {mutate_file("robot_yaml", "robot.yaml", bomb, Random(seed)) for seed in range(50)}
    assert len(mutated) > 10
    assert max(map(len, mutated)) < 10 * len(bomb) + 200_000


def test_the_report_counts(tmp_path: Path) -> None:
    tally = Tally()
    for seed in range(5):
        tally.add(Outcome("urdf", seed, "crash" if seed == 3 else "refused", where="SIGSEGV"))
    assert (tally.thrown, tally.lost) == (5, 1)
    assert "| `urdf` | 5 | 0 | 4 | 1 |" in tally.table(1.0)
    assert "python -m tests.attack --kind urdf --seed 3" in tally.list_findings()
    assert sum(shares(COUNT, KINDS).values()) == COUNT
    assert throw(make_case("rows", 1), tmp_path).seconds < 5.0
