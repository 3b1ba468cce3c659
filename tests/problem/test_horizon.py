"""Horizons that are too long for the memory are refused before anything is allocated."""

from __future__ import annotations

import resource
from pathlib import Path

import pytest

import mbocp
from mbocp import _memory
from mbocp._memory import bytes_per_step, check_memory, memory_limit
from mbocp.exceptions import InvalidValue, MemoryLimitExceeded
from mbocp.formulation import transcribe

PENDULUM = Path(__file__).parents[2] / "examples" / "paper" / "rigid_pendulum.toml"


@pytest.mark.parametrize("exponent", [9, 12, 18])
def test_too_many_steps_are_refused_by_name(monkeypatch: pytest.MonkeyPatch, exponent: int) -> None:
    monkeypatch.setenv("MBOCP_MEMORY_LIMIT", "16000")
    words = (
        rf"horizon.steps: 1e\+{exponent:02} steps .* would take about .* GB of memory; the limit is 16 GB "
        r"\(MBOCP_MEMORY_LIMIT\). Take fewer steps, or set MBOCP_MEMORY_LIMIT"
    )
    with pytest.raises(MemoryLimitExceeded, match=words):
        mbocp.load_problem(PENDULUM, [f"horizon.steps={10**exponent}"])


def test_a_problem_that_was_made_in_python_is_refused_too(monkeypatch: pytest.MonkeyPatch) -> None:
    with pytest.raises(MemoryLimitExceeded, match=r"horizon.steps"):
        mbocp.load_problem(PENDULUM).with_(num_steps=10**9)


def test_the_limit_may_be_raised(monkeypatch: pytest.MonkeyPatch) -> None:
    problem = mbocp.load_problem(PENDULUM, ["horizon.steps=10000"])
    monkeypatch.setenv("MBOCP_MEMORY_LIMIT", "50")
    with pytest.raises(MemoryLimitExceeded, match=r"the limit is 50 MB"):
        transcribe(problem)
    monkeypatch.setenv("MBOCP_MEMORY_LIMIT", "500")
    assert transcribe(problem).num_steps == 10000
    monkeypatch.setenv("MBOCP_MEMORY_LIMIT", "plenty")
    with pytest.raises(InvalidValue, match="MBOCP_MEMORY_LIMIT: got 'plenty', expected a number"):
        transcribe(problem)


def test_a_step_is_a_few_matrices_of_its_unknowns() -> None:
    assert 1e4 < bytes_per_step(16) < 1.2e4  # measured: 8.6 kB
    assert 2e4 < bytes_per_step(30) < 3e4  # measured: 20.5 kB, with limits 22.3 kB
    ratio = bytes_per_step(2000) / bytes_per_step(1000)
    assert ratio == pytest.approx(4.0, rel=0.01)


@pytest.mark.parametrize(
    ("line", "files"),
    [
        (
            "0::/job/step",
            {"job/memory.max": "1000", "job/memory.current": "600", "job/step/memory.max": "max"},
        ),
        (
            "3:cpu:/\n7:memory:/job",
            {"memory/job/memory.limit_in_bytes": "1000", "memory/job/memory.usage_in_bytes": "600"},
        ),
    ],
    ids=["version 2", "version 1"],
)
def test_a_container_s_limit_counts(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, line: str, files: dict[str, str]
) -> None:
    read = _memory._text
    for name, text in files.items():
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).write_text(text + "\n")
    stat = next(tmp_path.rglob("job")) / "memory.stat"
    stat.write_text("anon 500\ninactive_file 100\n")
    monkeypatch.setattr(_memory, "_CGROUPS", tmp_path)
    monkeypatch.setattr(_memory, "_text", lambda p: line if p == Path("/proc/self/cgroup") else read(p))
    monkeypatch.delenv("MBOCP_MEMORY_LIMIT", raising=False)
    assert memory_limit()[0] == pytest.approx(0.8 * 500.0)
    with pytest.raises(MemoryLimitExceeded, match=r"80 % of the memory that is left"):
        check_memory(401.0, "it", "Take less")


def test_a_process_s_limit_counts(monkeypatch: pytest.MonkeyPatch) -> None:
    held = resource.getpagesize() * int(Path("/proc/self/statm").read_text().split()[0])
    limits = {resource.RLIMIT_AS: held + 10**9}
    monkeypatch.setattr(resource, "getrlimit", lambda kind: (limits[kind], -1))
    monkeypatch.delenv("MBOCP_MEMORY_LIMIT", raising=False)
    assert memory_limit()[0] == pytest.approx(0.8e9, rel=1e-2)
