"""C in several files computes what it does in one."""

from __future__ import annotations

import re
import subprocess
from pathlib import Path

import casadi as ca
import numpy as np
import pytest

from mbocp.exceptions import CompilationError
from mbocp.programme import files, library
from mbocp.programme.compilation import load_functions
from mbocp.programme.compiler import compiler
from mbocp.programme.files import spread
from mbocp.programme.lanes import Lanes
from mbocp.programme.splitting import split_functions
from tests.programme.test_splitting import SIZES, generated, tangled

needs_compiler = pytest.mark.skipif(compiler() is None, reason="no C compiler")
PIECE = 40


@pytest.fixture(autouse=True)
def short(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(files, "_LEAST", 100)


@pytest.fixture(params=[None, Lanes(4, frozenset({"tangled"}))], ids=["plain", "lanes"])
def text(request: pytest.FixtureRequest, tmp_path: Path) -> str:
    return split_functions(generated([tangled()], tmp_path), PIECE, request.param)


def bodies(text: str) -> list[str]:
    """Statements of a text, in any order."""
    return sorted(line for line in text.split("\n") if line.startswith("  ") and line.endswith(";"))


@pytest.mark.parametrize("count", [2, 3, 4])
def test_every_piece_is_in_one_file(text: str, count: int) -> None:
    found = spread(text, count)
    assert 1 < len(found) <= count
    defined = [line for file in found for line in file.split("\n") if "_part" in line and line.endswith("{")]
    assert len(defined) == len(set(defined)) == text.count("static __attribute__((noinline)) void")
    lengths = [len(file.split("\n")) for file in found]
    assert max(lengths) < len(text.split("\n"))
    first = text.index("static __attribute__((noinline)) void")
    head, others = bodies(text[:first]), found[1:]
    statements = [line for file in found for line in bodies(file)]
    for _ in others:
        for line in head:
            statements.remove(line)
    assert sorted(statements) == bodies(text)


def test_short_text_stays_whole(text: str, monkeypatch: pytest.MonkeyPatch) -> None:
    assert spread(text, 1) == [text]
    assert spread("int x;\n" * 1000, 4) == ["int x;\n" * 1000]
    monkeypatch.setattr(files, "_LEAST", 10**6)
    assert spread(text, 4) == [text]


@needs_compiler
def test_results_are_the_same_bits(text: str, tmp_path: Path) -> None:
    cc, count = compiler(), 3
    assert cc is not None
    command = [*cc, "-O1", "-fPIC", "-shared", "-mavx2", "-mfma", "-Wall", "-Wno-unused", "-Werror"]
    command += ["-Wno-unused-but-set-variable", "-Wno-psabi"]
    found = {}
    for number in (1, count):
        objects = []
        for i, file in enumerate(spread(text, number)):
            source, made = tmp_path / f"{number}{i}.c", tmp_path / f"{number}{i}.o"
            source.write_text(file)
            subprocess.run([*command, "-c", "-o", str(made), str(source)], check=True)
            objects.append(str(made))
        library = tmp_path / f"library{number}{len(objects)}.so"
        subprocess.run([*command, "-o", str(library), *objects, "-lm"], check=True)
        function = ca.external("tangled", str(library))
        rng = np.random.default_rng(1)
        points = [[rng.normal(size=n) for n in SIZES] for _ in range(50)]
        found[number] = [np.asarray(out).tobytes() for point in points for out in function(*point)]
    assert found[1] == found[count]


def with_helpers() -> ca.Function:
    """A function that calls functions which CasADi brings, with signatures of one line and of two."""
    x, y = ca.MX.sym("x", SIZES[0]), ca.MX.sym("y", SIZES[1])
    sparse = ca.MX(ca.Sparsity.lower(2), x[:3])
    return ca.Function("helped", [x, y], [sparse.T @ y[:2], ca.mtimes(sparse, sparse.T)])


@needs_compiler
@pytest.mark.parametrize("count", [2, 4])
def test_what_casadi_brings_is_in_no_other_file(count: int, tmp_path: Path) -> None:
    """Each file has its own, so that they link."""
    text = split_functions(generated([tangled(), with_helpers()], tmp_path), PIECE, None)
    assert re.search(r"^void casadi_trans\([^)]*\n[^)]*\) \{", text, re.M)
    first, *others = spread(text, count)
    cc, objects = compiler(), []
    assert cc is not None
    for i, file in enumerate([first, *others]):
        source, made = tmp_path / f"{i}.c", tmp_path / f"{i}.o"
        source.write_text(file)
        subprocess.run([*cc, "-O1", "-fPIC", "-c", "-o", str(made), str(source)], check=True)
        objects.append(str(made))
    library = str(tmp_path / "library.so")
    subprocess.run([*cc, "-shared", "-Wl,--no-undefined", "-o", library, *objects, "-lm"], check=True)
    function, ours = with_helpers(), ca.external("helped", library)
    point = [np.linspace(0.1, 1.0, n) for n in SIZES]
    for found, expected in zip(ours(*point), function(*point), strict=True):
        np.testing.assert_allclose(np.asarray(found), np.asarray(expected), rtol=1e-14)


@needs_compiler
def test_a_library_of_several_files_is_used(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("MBOCP_CACHE_DIR", str(tmp_path / "cache"))
    monkeypatch.setattr(library, "available_threads", lambda: 3)
    seen: list[int] = []
    run = library.run_compiler

    def counted(*arguments: object, **options: list[list[str]]) -> None:
        seen.append(len(options.get("before", [])))
        run(*arguments, **options)  # type: ignore[arg-type]

    monkeypatch.setattr(library, "run_compiler", counted)
    function = tangled()
    made = load_functions("several", lambda: {"tangled": function})
    assert made.compiled_now
    assert seen == [3]
    point = [np.linspace(0.1, 1.0, n) for n in SIZES]
    for ours, theirs in zip(made.function("tangled")(*point), function(*point), strict=True):
        np.testing.assert_allclose(np.asarray(ours), np.asarray(theirs), rtol=1e-12, atol=1e-12)


@needs_compiler
@pytest.mark.parametrize("bad", ["stage0.c", "stage1.c", "stage0.o"])
def test_a_file_that_fails_is_an_error(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, bad: str) -> None:
    cc, script = compiler(), tmp_path / "cc"
    assert cc is not None
    script.write_text(
        f'#!/bin/sh\nfor word in "$@"; do last=$word; case "$word" in */{bad}) is_bad=1;; esac; done\n'
        f'if [ "$is_bad" ] && {{ [ {bad} != stage0.o ] || [ "$last" = -lm ]; }}\n'
        f'then echo "no {bad} today"; exit 3; fi\nexec {cc[0]} "$@"\n'
    )
    script.chmod(0o700)
    monkeypatch.setenv("CC", str(script))
    monkeypatch.setenv("MBOCP_CACHE_DIR", str(tmp_path / "cache"))
    monkeypatch.setattr(library, "available_threads", lambda: 2)
    with pytest.raises(CompilationError, match=rf"(?s)C compiler .*/cc failed .*exit 3.*no {bad} today"):
        load_functions("several", lambda: {"tangled": tangled()})
