"""Faults around the cache of compiled functions: disks, foreign things, processes that are killed."""

from __future__ import annotations

import errno
import fcntl
import os
import shutil
import signal
import stat
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path

import casadi as ca
import pytest

from mbocp.exceptions import CompilationError, CompilationTimeout, InvalidValue
from mbocp.programme import cache, compiler
from mbocp.programme.cache import cache_folder, scratch_folder, seal, trim, write_entry
from mbocp.programme.compilation import CompiledFunctions, load_functions

pytestmark = pytest.mark.usefixtures("compiled")

LOADS = """
import casadi as ca
from mbocp.programme.compilation import load_functions
x = ca.SX.sym("x")
f = load_functions("key", lambda: {"f": ca.Function("f", [x], [2 * x])})
print(f.library, f.function("f")(21.0))
"""
SLOW = """#!/bin/sh
sleep 60 &
echo $$ $! > "$PIDS.part"
mv "$PIDS.part" "$PIDS"
wait
"""


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """Folder of the entries; each test begins as a new process does, and its temporary files are its own."""
    monkeypatch.setenv("MBOCP_CACHE_DIR", str(tmp_path / "cache"))
    (tmp_path / "tmp").mkdir()
    monkeypatch.setenv("TMPDIR", str(tmp_path / "tmp"))
    monkeypatch.setattr(tempfile, "tempdir", None)
    remembered = (cache._tell, cache._make_private_folder, cache._sweep, cache._room_in)
    for function in remembered:
        function.cache_clear()
    yield tmp_path / "cache" / "stages"
    for function in remembered:
        function.cache_clear()


def load(key: str = "key", deadline: float = float("inf")) -> CompiledFunctions:
    """Functions of their own for each key."""
    x = ca.SX.sym("x")
    own = f"of_{key.replace(' ', '_')}"
    functions = {"f": ca.Function("f", [x], [2 * x]), own: ca.Function(own, [x], [x])}
    return load_functions(key, lambda: functions, deadline=deadline)


def works(functions: CompiledFunctions) -> bool:
    return float(functions.function("f")(21.0)) == 42.0


def entry() -> Path:
    """Where the entry belongs."""
    library = load().library
    assert library is not None
    library.unlink()
    return library


def refuse_to_write(monkeypatch: pytest.MonkeyPatch, folder: Path, number: int) -> None:
    """Let every attempt to make something in a folder fail, whoever the user is."""
    make = tempfile.mkdtemp

    def refuse(*, prefix: str, **where: Path) -> str:
        if where["dir"] == folder:
            raise OSError(number, os.strerror(number), str(folder))
        return make(prefix=prefix, **where)

    monkeypatch.setattr(tempfile, "mkdtemp", refuse)


def test_a_folder_that_others_may_write_to_is_not_used(folder: Path) -> None:
    assert stat.S_IMODE(cache_folder().stat().st_mode) == 0o700
    folder.chmod(0o777)
    with pytest.warns(RuntimeWarning, match="somebody else may write to it"):
        other = cache_folder()
    assert other != folder
    assert stat.S_IMODE(other.stat().st_mode) == 0o700


@pytest.mark.parametrize("number", [errno.EROFS, errno.ENOSPC, errno.EACCES])
def test_a_folder_that_cannot_be_written_is_replaced(
    folder: Path, monkeypatch: pytest.MonkeyPatch, number: int
) -> None:
    sound = load("before")
    refuse_to_write(monkeypatch, folder, number)
    assert load("before").library == sound.library  # what is there is used
    with pytest.warns(RuntimeWarning, match=f"{os.strerror(number)}.*set MBOCP_CACHE_DIR") as told:
        first = load()
    assert len(told) == 1
    assert first.compiled_now
    assert works(first)
    again = load()  # says nothing any more
    assert not again.compiled_now
    assert again.library == first.library


def test_no_room_anywhere_is_one_error(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(*_: object, **__: object) -> str:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    monkeypatch.setattr(tempfile, "mkdtemp", refuse)
    with (
        pytest.warns(RuntimeWarning, match="No space left"),
        pytest.raises(CompilationError, match=r"No space left on device.*set MBOCP_CACHE_DIR"),
    ):
        load()


def test_a_compiler_without_room_is_no_compiler_that_fails(
    folder: Path, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    """The disk fills up while it writes: the temporary folder takes over, on another disk as a rule."""
    cc = tmp_path / "cc"
    (real, *_) = compiler.compiler() or ()
    full = f'case "$*" in *{folder}*) echo "ld: No space left on device"; exit 1;; esac'
    cc.write_text(f'#!/bin/sh\n{full}\nexec {real} "$@"\n')
    cc.chmod(0o755)
    monkeypatch.setenv("CC", str(cc))
    usage = shutil.disk_usage(tmp_path)
    monkeypatch.setattr(compiler.shutil, "disk_usage", lambda _: usage._replace(free=4096))
    with pytest.warns(RuntimeWarning, match="No space left on device"):
        assert works(load())
    assert not list(folder.iterdir())


def test_a_user_without_a_home_gets_a_temporary_folder(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def homeless() -> Path:
        raise RuntimeError("Could not determine home directory.")

    monkeypatch.delenv("MBOCP_CACHE_DIR")
    monkeypatch.delenv("XDG_CACHE_HOME", raising=False)
    monkeypatch.setattr(Path, "home", homeless)
    with pytest.warns(RuntimeWarning, match="Could not determine home directory"):
        assert works(load())


@pytest.fixture
def alarm() -> Iterator[None]:
    """What hangs fails."""

    def fail(*_: object) -> None:
        raise TimeoutError("hangs")

    before = signal.signal(signal.SIGALRM, fail)
    signal.alarm(30)
    yield
    signal.alarm(0)
    signal.signal(signal.SIGALRM, before)


@pytest.mark.usefixtures("alarm")
def test_a_fifo_is_replaced(folder: Path) -> None:
    path = entry()
    os.mkfifo(path)
    again = load()
    assert again.compiled_now
    assert works(again)
    assert path.is_file()


def test_a_link_is_replaced_and_not_followed(folder: Path, tmp_path: Path) -> None:
    path = entry()
    elsewhere = tmp_path / "elsewhere"
    elsewhere.write_bytes(seal(b"not ours"))
    path.symlink_to(elsewhere)
    assert load().compiled_now
    assert not path.is_symlink()
    assert elsewhere.read_bytes() == seal(b"not ours")


def test_a_folder_in_the_place_of_an_entry_stays(folder: Path) -> None:
    path = entry()
    (path / "something").mkdir(parents=True)
    with pytest.warns(RuntimeWarning, match="Is a directory"):
        other = load()
    assert works(other)
    assert other.library is not None
    assert other.library.parent != folder
    assert (path / "something").is_dir()


def leftover(folder: Path, name: str) -> int:
    """Folder of a process that works there as long as the returned file is open."""
    path = folder / name
    path.mkdir(parents=True)
    (path / "stage.c").write_text("half")
    handle = os.open(path / "lock", os.O_RDWR | os.O_CREAT)
    fcntl.flock(handle, fcntl.LOCK_EX)
    return handle


def test_only_what_belongs_to_no_process_is_swept(folder: Path) -> None:
    alive = leftover(folder, "build-alive")
    os.close(leftover(folder, "build-dead"))
    (folder / "build-empty").mkdir()
    (folder / "build-strange").mkdir()
    (folder / "build-strange" / "file").write_text("no lock: not made by us")
    (folder / "build-link").symlink_to(folder / "build-strange")
    load()
    left = {path.name for path in folder.glob("build-*")}
    os.close(alive)
    assert left == {"build-alive", "build-strange", "build-link"}


def test_a_folder_that_is_swept_while_it_is_made_is_made_again(
    folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    make, made = tempfile.mkdtemp, []

    def swept(*args: object, **kwargs: object) -> str:
        made.append(make(*args, **kwargs))
        if len(made) == 1:
            Path(made[0]).rmdir()
        return made[-1]

    monkeypatch.setattr(tempfile, "mkdtemp", swept)
    cache_folder()
    with scratch_folder(folder) as scratch:
        assert (scratch / "lock").is_file()
    assert len(made) == 2


def test_entries_used_longest_ago_go_first(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    libraries = [load(f"key {i}").library for i in range(4)]
    size = max(path.stat().st_size for path in folder.glob("*.so"))
    hour = 3600
    now = time.time()
    for age, library in zip((5, 0, 4, 3), libraries, strict=True):
        assert library is not None
        os.utime(library, (now - age * hour, library.stat().st_mtime))
    monkeypatch.setenv("MBOCP_CACHE_LIMIT", str(2.5 * size / 1e6))
    trim(folder)
    assert set(folder.glob("*.so")) == {libraries[1], libraries[3]}
    monkeypatch.setenv("MBOCP_CACHE_LIMIT", "0")
    os.utime(libraries[3], (now, now))
    trim(folder)
    assert set(folder.glob("*.so")) == {libraries[1], libraries[3]}  # somebody may be about to load them
    os.utime(libraries[1], (now + 2 * hour, now))  # after a clock that jumped, the order is all that counts
    trim(folder)
    assert set(folder.glob("*.so")) == {libraries[1]}
    monkeypatch.setenv("MBOCP_CACHE_LIMIT", "much")
    with pytest.raises(InvalidValue, match="MBOCP_CACHE_LIMIT: got 'much', expected a number of megabytes"):
        trim(folder)


def test_what_is_there_is_looked_at_now_and_then(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Not at every entry that is written: with thousands there that takes longer than to write one."""
    looked: list[Path] = []
    monkeypatch.setattr(cache, "entries", lambda where: looked.append(where) or [])
    body, limit = bytes(1000), 100_000
    monkeypatch.setenv("MBOCP_CACHE_LIMIT", str(limit / 1e6))
    for number in range(100):
        assert write_entry(f"{number}.tape", body) is not None
    assert 15 <= len(looked) <= 20
    looked.clear()
    monkeypatch.setenv("MBOCP_CACHE_LIMIT", "0")
    for number in range(3):
        write_entry(f"{number}.tape", body)
    assert len(looked) == 3


def test_what_is_used_is_marked_as_used(folder: Path) -> None:
    library = load().library
    assert library is not None
    os.utime(library, (1e9, 1e9))
    assert not load().compiled_now
    assert library.stat().st_atime > 1e9
    assert library.stat().st_mtime == 1e9


def slow_compiler(tmp_path: Path) -> dict[str, str]:
    """Environment with a compiler that starts another process and takes a minute."""
    script = tmp_path / "cc"
    script.write_text(SLOW)
    script.chmod(0o755)
    return {**os.environ, "CC": str(script), "PIDS": str(tmp_path / "pids")}


def started(tmp_path: Path) -> list[int]:
    """Processes of the compiler, once it runs."""
    return [int(word) for word in waited_for(tmp_path / "pids").read_text().split()]


def waited_for(path: Path) -> Path:
    end = time.monotonic() + 60
    while not path.exists():
        assert time.monotonic() < end, f"{path} never came"
        time.sleep(0.02)
    return path


def are_gone(pids: list[int]) -> bool:
    """Whether processes end within seconds; one that nobody has waited for yet has ended, too."""
    end = time.monotonic() + 20
    while any(is_running(pid) for pid in pids):
        if time.monotonic() > end:
            return False
        time.sleep(0.02)
    return True


def is_running(pid: int) -> bool:
    try:
        os.kill(pid, 0)
    except ProcessLookupError:
        return False
    try:
        return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0] != "Z"
    except OSError:
        return False


@pytest.mark.parametrize("number", [signal.SIGKILL, signal.SIGTERM, signal.SIGINT])
def test_a_compiler_ends_with_its_parent(folder: Path, tmp_path: Path, number: signal.Signals) -> None:
    parent = subprocess.Popen(
        [sys.executable, "-c", LOADS], env=slow_compiler(tmp_path), stderr=subprocess.PIPE
    )
    pids = started(tmp_path)
    assert all(is_running(pid) for pid in pids)
    parent.send_signal(number)
    parent.communicate(timeout=30)
    assert are_gone(pids)
    left = list(folder.glob("build-*"))
    assert bool(left) == (number != signal.SIGINT)
    assert works(load())  # the next process sweeps
    assert sorted(path.suffix for path in folder.iterdir()) == [".key", ".so"]


def test_a_compiler_ends_at_the_deadline(
    folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for key, value in slow_compiler(tmp_path).items():
        monkeypatch.setenv(key, value)
    with pytest.raises(CompilationTimeout, match="time_limit passed while the C compiler ran"):
        load(deadline=time.perf_counter() + 1.0)
    assert are_gone(started(tmp_path))
    assert not list(folder.iterdir())
    with pytest.raises(CompilationTimeout, match="the functions were to be built"):
        load(deadline=time.perf_counter() - 1.0)


def test_temporary_folders_go_with_their_process(folder: Path, tmp_path: Path) -> None:
    temporary = tmp_path / "tmp"
    os.close(leftover(temporary, "mbocp-stages-dead"))
    alive = leftover(temporary, "mbocp-stages-alive")
    (tmp_path / "file").touch()
    done = subprocess.run(
        [sys.executable, "-W", "ignore", "-c", LOADS],
        env={**os.environ, "MBOCP_CACHE_DIR": str(tmp_path / "file")},
        capture_output=True,
        text=True,
        check=True,
    )
    os.close(alive)
    assert str(temporary) in done.stdout
    assert "42" in done.stdout
    assert [path.name for path in temporary.iterdir()] == ["mbocp-stages-alive"]
