"""Two keys of compiled functions: what they depend on, and their C code."""

from __future__ import annotations

import os
from collections.abc import Callable
from pathlib import Path

import casadi as ca
import pytest

import mbocp
from mbocp.formulation import build, signature, transcribe
from mbocp.programme import compilation, library
from mbocp.programme.compilation import load_functions
from mbocp.terms import running

pytestmark = pytest.mark.usefixtures("compiled")

Functions = dict[str, ca.Function]
LIBRARIES = 2  # of a problem: the functions of its stages, and those of its end


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setenv("MBOCP_CACHE_DIR", str(tmp_path / "cache"))
    return tmp_path / "cache" / "stages"


def times(factor: float) -> Callable[[], Functions]:
    x = ca.SX.sym("x")
    return lambda: {"f": ca.Function("f", [x], [factor * x])}


def never() -> Functions:
    raise AssertionError("built although it is in the cache")


def test_the_same_code_is_compiled_once_whatever_it_depends_on(folder: Path) -> None:
    first = load_functions("one", times(2.0))
    second = load_functions("two", times(2.0))
    other = load_functions("three", times(3.0))
    assert [f.compiled_now for f in (first, second, other)] == [True, False, True]
    assert first.library == second.library != other.library
    assert (first.function("f")(1.0), other.function("f")(1.0)) == (2.0, 3.0)
    for key, found in (("one", first), ("two", second), ("three", other)):
        assert load_functions(key, never).library == found.library


def test_a_process_searches_for_functions_once(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    first = load_functions("key", times(2.0))
    monkeypatch.setattr(compilation, "library_of", lambda key: pytest.fail("searched again"))
    assert load_functions("key", never).library == first.library


def test_functions_that_have_gone_since_are_made_again(folder: Path) -> None:
    library = load_functions("key", times(2.0)).library
    assert library is not None
    library.unlink()
    again = load_functions("key", times(2.0))
    assert again.compiled_now
    assert again.library == library
    assert library.is_file()


def test_functions_of_another_folder_are_not_taken(
    folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    first = load_functions("key", times(2.0))
    monkeypatch.setenv("MBOCP_CACHE_DIR", str(tmp_path / "other"))
    other = load_functions("key", times(2.0))
    assert other.compiled_now
    assert first.library != other.library


def pendulum() -> mbocp.Problem:
    return mbocp.Problem.create(
        "double_pendulum",
        1.0,
        10,
        goal={"q": [1.0, 0.0]},
        cost={"effort": 1.0, "velocity": 0.1},
        scheme="se1",
    )


def test_a_comment_in_the_source_of_a_term_compiles_nothing_anew(
    folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    built: list[str] = []
    write = build.build_first_functions

    def counted(*args: object) -> Functions:
        built.append("stage")
        return write(*args)

    monkeypatch.setattr(build, "build_first_functions", counted)
    first = transcribe(pendulum())
    transcribe(pendulum())
    assert len(built) == 1
    read, edited = Path.read_bytes, Path(str(running.__file__))

    def with_a_comment(path: Path) -> bytes:
        return read(path) + b"# a comment\n" if path == edited else read(path)

    monkeypatch.setattr(Path, "read_bytes", with_a_comment)
    signature.sources_digest.cache_clear()
    try:
        second = transcribe(pendulum())
    finally:
        signature.sources_digest.cache_clear()
    assert len(built) == 2, "what a source says may have changed the functions"
    for a, b in ((first.functions, second.functions), (first.end_functions, second.end_functions)):
        assert not b.compiled_now
        assert a.library == b.library
    assert len(list(folder.glob("*.so"))) == LIBRARIES


@pytest.mark.parametrize("damage", ["empty", "words", "elsewhere", "folder", "fifo", "link", "nothing"])
def test_what_is_no_file_of_a_key_is_made_anew(folder: Path, tmp_path: Path, damage: str) -> None:
    library = load_functions("key", times(2.0)).library
    assert library is not None
    (file,) = folder.glob("*.key")
    name = file.read_bytes()
    assert name.decode() == library.name
    file.unlink()
    if damage in ("empty", "words", "elsewhere"):
        file.write_bytes({"empty": b"", "words": b"no name", "elsewhere": b"../" + name}[damage])
    elif damage == "folder":
        file.mkdir()
    elif damage == "fifo":
        os.mkfifo(file)
    elif damage == "link":
        (tmp_path / "name").write_bytes(name)
        file.symlink_to(tmp_path / "name")
    compilation._place.cache_clear()  # what another process knows
    again = load_functions("key", times(2.0))
    assert not again.compiled_now
    assert again.library == library
    if damage != "folder":  # which stays, and only costs the building
        assert file.read_bytes() == name
        assert not file.is_symlink()
        load_functions("key", never)


def test_a_key_whose_library_is_gone_has_it_compiled_again(folder: Path) -> None:
    library = load_functions("key", times(2.0)).library
    assert library is not None
    library.unlink()
    assert load_functions("key", times(2.0)).compiled_now
    assert library.is_file()


def test_the_oldest_files_of_keys_are_removed(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(library, "_MOST", 3)
    compiled = load_functions("0", times(2.0)).library
    for i in range(1, 5):
        file = max(folder.glob("*.key"), key=lambda path: path.stat().st_mtime_ns)
        os.utime(file, (i, i))
        assert not load_functions(str(i), times(2.0)).compiled_now
    assert len(list(folder.glob("*.key"))) == 3
    assert load_functions("4", never).library == compiled
    assert not load_functions("0", times(2.0)).compiled_now
