"""The cache of compiled stage functions: shared, checked, private, and not needed."""

from __future__ import annotations

import multiprocessing
import os
import shutil
from pathlib import Path

import casadi as ca
import numpy as np
import pytest

import mbocp
from mbocp.exceptions import CompilationError, InvalidValue
from mbocp.formulation import transcribe
from mbocp.problem import Problem
from mbocp.programme import compilation, library
from mbocp.programme.c_files import CText
from mbocp.programme.compilation import NoCompilerWarning, load_functions
from mbocp.programme.compiler import compiler
from mbocp.robot.payload import Payload

pytestmark = pytest.mark.usefixtures("compiled")

EXAMPLES = Path(__file__).parents[2] / "examples"


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setenv("MBOCP_CACHE_DIR", str(tmp_path / "cache"))
    return tmp_path / "cache" / "stages"


def doubling() -> dict[str, ca.Function]:
    x = ca.SX.sym("x")
    return {"f": ca.Function("f", [x], [2 * x])}


def never() -> dict[str, ca.Function]:
    raise AssertionError("built although it is in the cache")


GCC = ("/usr/bin/gcc",)
LIBRARIES = 2  # of a shape: the functions of its stages, and those of its end


def pendulum(**changes: object) -> Problem:
    problem = mbocp.load_problem(EXAMPLES / "paper" / "rigid_pendulum.toml", ["horizon.steps=10"])
    return problem.with_(**changes) if changes else problem


def test_second_call_builds_nothing(folder: Path) -> None:
    first = load_functions("key", doubling)
    second = load_functions("key", never)
    assert first.compiled_now
    assert not second.compiled_now
    assert first.library == second.library
    assert first.library is not None
    assert first.library.parent == folder


def test_tasks_of_one_shape_share_their_functions(folder: Path) -> None:
    transcribe(pendulum())
    assert len(list(folder.glob("*.so"))) == LIBRARIES
    for settings in (
        ["horizon.duration=1.3", "horizon.steps=37"],
        ["start.q=[0, 5, 0]", "start.p=[0, 0, 1]"],
        ["goal.q=[3, 0, -4]", "cost.effort=0.3"],
    ):
        other = mbocp.load_problem(EXAMPLES / "paper" / "rigid_pendulum.toml", settings)
        programme = transcribe(other)
        assert not programme.functions.compiled_now
        assert not programme.end_functions.compiled_now
    assert len(list(folder.glob("*.so"))) == LIBRARIES
    penalised = mbocp.load_problem(
        EXAMPLES / "paper" / "rigid_pendulum.toml", ['goal.enforce="penalty"', "cost.terminal=1.0"]
    )
    programme = transcribe(penalised)
    assert not programme.functions.compiled_now  # only the end is another one
    assert programme.end_functions.compiled_now


def within_limits(**others: object) -> Problem:
    """Two links below a height, slower than a speed, with torques within bounds."""
    words: dict[str, object] = {
        "goal": {"q": [0.4, -0.3], "v": [0.0, 0.0]},
        "limits": {"effort": 20.0, "velocity": 6.0},
        "path": [{"name": "below", "kind": "position", "frame": "link2", "z": [-10.0, 3.0]}],
        **others,
    }
    return Problem.create("double_pendulum", 1.0, 8, **{"integrator": {"scheme": "se1"}, **words})  # type: ignore[arg-type]


def test_bounds_are_parameters(folder: Path) -> None:
    first = transcribe(within_limits())
    assert first.functions.compiled_now
    higher = [{"name": "other", "kind": "position", "frame": "link2", "z": [-3.0, 7.0]}]
    for others in (
        {"limits": {"effort": 31.0, "velocity": [[-2.0, 5.0], [-6.0, 6.0]]}},
        {"limits": {"velocity": 6.0}},
        {"path": higher},
        {"path": higher, "start": {"q": [0.1, 0.2]}, "cost": {"effort": 3.0, "velocity": 2.0}},
    ):
        programme = transcribe(within_limits(**others))
        assert not programme.functions.compiled_now, others
        assert not programme.end_functions.compiled_now, others
    assert len(list(folder.glob("*.so"))) == LIBRARIES


def test_bodies_that_carry_payloads_are_no_parameters_but_their_masses_are(folder: Path) -> None:
    robot = mbocp.load_robot("double_pendulum")
    for frame in ("link1", "link2"):
        for mass in (1.0, 2.0):
            carrying = robot.with_payload(Payload(frame=frame, mass=mass, name="ball"))
            goal = {"q": [0.4, -0.3], "v": [0.0, 0.0]}
            functions = transcribe(Problem.create(carrying, 1.0, 8, goal=goal, scheme="se1")).functions
            assert functions.compiled_now == (mass == 1.0)


@pytest.mark.parametrize("damage", ["truncated", "overwritten", "empty", "foreign"])
def test_a_corrupt_entry_is_rebuilt(folder: Path, damage: str) -> None:
    library = load_functions("key", doubling).library
    assert library is not None
    content = library.read_bytes()
    wrong = {
        "truncated": content[: len(content) // 2],
        "overwritten": content[:1000] + b"\0" * 100 + content[1100:],
        "empty": b"",
        "foreign": b"\x7fELF not ours",
    }[damage]
    library.unlink()
    library.write_bytes(wrong)
    again = load_functions("key", doubling)
    assert again.compiled_now
    assert not load_functions("key", never).compiled_now


def fill(key: str) -> bool:
    return load_functions(key, doubling).library is not None


def test_processes_may_fill_the_cache_together(folder: Path) -> None:
    context = multiprocessing.get_context("spawn")
    with context.Pool(2) as pool:
        assert all(pool.map(fill, ["same"] * 6))
    assert len(list(folder.glob("*.so"))) == 1
    assert not list(folder.glob("build-*"))


def test_without_a_compiler_the_functions_are_interpreted(
    folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    compiled = mbocp.solve(pendulum())
    monkeypatch.setenv("CC", "")
    monkeypatch.setenv("PATH", str(folder))
    for entry in folder.glob("*.so"):
        entry.unlink()
    compilation._warn_no_compiler.cache_clear()
    with pytest.warns(NoCompilerWarning, match=r"pip install mbocp\[compiler\], or install gcc"):
        interpreted = mbocp.solve(pendulum())
    mbocp.solve(pendulum())  # says nothing any more: warnings are errors
    assert interpreted.iterations == compiled.iterations
    assert np.allclose(interpreted.us, compiled.us, atol=1e-12)


def test_a_compiler_may_be_a_package(folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A package `ziglang` that hands over to the usual compiler, without what that one does not know."""
    (real, *_) = compiler() or ()
    package = tmp_path / "packages" / "ziglang"
    package.mkdir(parents=True)
    (package / "__init__.py").touch()
    (package / "__main__.py").write_text(
        "import os, sys\n"
        "cc, target, triple, *rest = sys.argv[1:]\n"
        "assert (cc, target) == ('cc', '-target') and '-fsched-pressure' not in rest\n"
        "assert os.environ['ZIG_GLOBAL_CACHE_DIR'].endswith('zig')\n"
        f"os.environ['PATH'] = {os.environ['PATH']!r}\n"
        f"os.execv({real!r}, [{real!r}, *rest])\n"
    )
    monkeypatch.setenv("CC", "")
    monkeypatch.setenv("PATH", "/nowhere")
    monkeypatch.setenv("PYTHONPATH", str(package.parent))
    monkeypatch.syspath_prepend(str(package.parent))
    assert (compiler() or ())[1:4] == ("-m", "ziglang", "cc")
    assert load_functions("key", doubling).compiled_now
    assert not load_functions("key", never).compiled_now


def test_a_compiler_that_fails_is_named(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    script = folder.parent / "cc"
    script.parent.mkdir(parents=True, exist_ok=True)
    script.write_text("#!/bin/sh\necho out of order >&2\nexit 3\n")
    script.chmod(0o755)
    monkeypatch.setenv("CC", str(script))
    with pytest.raises(CompilationError, match=r"(?s)cc failed.*exit 3.*out of order"):
        load_functions("key", doubling)
    assert not list(folder.glob("*.so"))
    assert not list(folder.glob("build-*"))


def test_a_compiler_that_makes_nothing_is_named(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("CC", shutil.which("true") or "")
    with pytest.raises(CompilationError, match=r"true reports no error, but has made no library; set CC"):
        load_functions("key", doubling)
    assert not list(folder.iterdir())


def test_the_compiler_may_have_options_and_a_wrapper(
    folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (real, *_) = compiler() or ()
    wrapper = tmp_path / "a wrapper"
    wrapper.write_text('#!/bin/sh\necho "$@" >> "$0.log"\nexec "$@"\n')
    wrapper.chmod(0o755)
    monkeypatch.setenv("CC", f"'{wrapper}' {Path(real).name} -DSOME='a b'")
    assert load_functions("key", doubling).compiled_now
    said = wrapper.with_name("a wrapper.log").read_text()
    assert said.startswith(f"{Path(real).name} -DSOME=a b -O")
    assert not load_functions("key", never).compiled_now
    monkeypatch.delenv("CC")
    assert load_functions("key", doubling).compiled_now, "options are part of what is compiled"


@pytest.mark.parametrize("named", ["", "no-such-compiler -m64", " "])
def test_a_compiler_that_is_not_there_is_another(named: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("CC", raising=False)
    usual = compiler()
    monkeypatch.setenv("CC", named)
    assert compiler() == usual


def test_a_program_whose_path_has_spaces_is_no_program_with_options(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    program = tmp_path / "my gcc -m64"
    program.touch(0o755)
    monkeypatch.setenv("CC", str(program))
    assert compiler() == (str(program),)


def test_a_quote_that_does_not_end_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("CC", "gcc '-m64")
    with pytest.raises(InvalidValue, match=r"CC: got \"gcc '-m64\", expected a compiler and its options"):
        compiler()


def test_gravity_and_masses_are_part_of_the_shape(folder: Path) -> None:
    heavy = mbocp.load_problem(
        EXAMPLES / "paper" / "rigid_pendulum.toml", ["horizon.steps=10", "robot.gravity=[0, 0, -3]"]
    )
    transcribe(pendulum())
    assert transcribe(heavy).functions.compiled_now
    assert len(list(folder.glob("*.so"))) == LIBRARIES + 1  # the functions of the end have no forces in them


def flags(functions: list[ca.Function], cc: tuple[str, ...] = GCC) -> tuple[str, ...]:
    return library._flags_for(cc, CText.of(functions))


def long_function() -> ca.Function:
    x = ca.SX.sym("x", 2)
    value = x[0]
    for _ in range(40):
        value = ca.sin(value) * x[1]
    return ca.Function("dense", [x], [value])


def test_a_function_in_pieces_is_optimised_however_long_it_is(monkeypatch: pytest.MonkeyPatch) -> None:
    x, table = ca.MX.sym("x"), ca.interpolant("table", "linear", [[0.0, 1.0]], [0.0, 2.0])
    by_casadi = ca.Function("by_casadi", [x], [table(x)])
    assert "-O0" not in flags([long_function(), by_casadi])
    monkeypatch.setattr(library, "_LONG", 20)
    assert "-O1" in flags([long_function()])
    assert "-O0" in flags([long_function(), by_casadi])


def test_clang_gets_no_options_of_gcc() -> None:
    dense = [long_function()]
    assert "-fno-tree-fre" in flags(dense, (*GCC, "-m64"))
    of_clang = flags(dense, ("/usr/bin/ccache", "clang-14"))
    assert "-fno-tree-fre" not in of_clang
