"""Files that replace others: whatever happens on the way, there is the old one or the new one."""

from __future__ import annotations

import contextlib
import fcntl
import os
import random
import resource
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from mbocp.exceptions import MbocpError, ResultFileError
from mbocp.solution import Solution, atomic
from mbocp.solution.atomic import atomic_path, replace_file
from mbocp.view.figures.style import new_figure, save_figure

from .fabricated import pendulum

DAY = 86_400.0  # [s]


@contextlib.contextmanager
def full_disk(free: int) -> Iterator[None]:
    """Let no file grow beyond `free` bytes, which any user can ask for: EFBIG instead of ENOSPC.

    Python would keep the bytecode of what is imported meanwhile, cut off there.
    """
    (soft, hard), writes = resource.getrlimit(resource.RLIMIT_FSIZE), sys.dont_write_bytecode
    resource.setrlimit(resource.RLIMIT_FSIZE, (free, hard))
    sys.dont_write_bytecode = True
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))
        sys.dont_write_bytecode = writes


def page(path: Path) -> Path:
    from mbocp.robot import load_robot
    from mbocp.view.replay import write_replay

    return write_replay(load_robot("rigid_pendulum"), [0.0, 1.0], [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0]], path)


def picture(path: Path) -> Path:
    figure = new_figure(3.0, 2.0)
    figure.add_subplot().plot([0, 1])
    return save_figure(figure, path)


WRITERS: dict[str, Callable[[Path], Path]] = {
    "result.h5": lambda path: pendulum(num_steps=20).save(path),
    "table.csv": lambda path: pendulum(num_steps=20).to_csv(path),
    "picture.png": picture,
    "picture.pdf": picture,
    "picture.svg": picture,
    "page.html": page,
}


@pytest.mark.parametrize("name", WRITERS)
def test_a_full_disk_is_one_error_and_leaves_the_old_file_whole(name: str, tmp_path: Path) -> None:
    path = tmp_path / name
    path.write_text("old")
    with (
        full_disk(2000),
        pytest.raises(MbocpError, match="File too large; what was there before is unchanged"),
    ):
        WRITERS[name](path)
    assert path.read_text() == "old"
    assert list(tmp_path.iterdir()) == [path]
    assert WRITERS[name](path) == path
    assert path.read_bytes()[:3] != b"old"


ON_A_FULL_DISK = """
import resource, sys
from pathlib import Path
from mbocp.exceptions import ResultFileError
from mbocp.solution import Solution
solution = Solution.load(sys.argv[1])
resource.setrlimit(resource.RLIMIT_FSIZE, (5000, 5000))
try:
    solution.save(sys.argv[1])
except ResultFileError as error:
    sys.exit(2)
"""


def test_a_full_disk_does_not_end_the_process_otherwise(tmp_path: Path) -> None:
    """HDF5 never sees the disk, so that nothing of it breaks when the process ends."""
    path = pendulum().save(tmp_path / "result.h5")
    ended = subprocess.run(
        [sys.executable, "-B", "-c", ON_A_FULL_DISK, path], check=False, capture_output=True, text=True
    )
    assert (ended.returncode, ended.stderr) == (2, "")
    assert Solution.load(path) == pendulum()


@pytest.mark.skipif(os.geteuid() != 0, reason="only root mounts")
def test_a_disk_that_is_really_full(tmp_path: Path) -> None:
    mount = ["mount", "-t", "tmpfs", "-o", "size=64k", "tmpfs", tmp_path]
    if subprocess.run(mount, check=False, capture_output=True).returncode:
        pytest.skip("no mounts here")
    try:
        path = pendulum(num_steps=20).save(tmp_path / "result.h5")
        with pytest.raises(ResultFileError, match="No space left on device; what was there before is"):
            pendulum(num_steps=500).save(path)
        assert list(tmp_path.iterdir()) == [path]
        assert Solution.load(path) == pendulum(num_steps=20)
    finally:
        subprocess.run(["umount", tmp_path], check=True)


@pytest.mark.skipif(os.geteuid() == 0, reason="root may write everywhere")
def test_a_folder_without_permission(tmp_path: Path) -> None:
    tmp_path.chmod(0o500)
    with pytest.raises(ResultFileError, match="cannot be written: Permission denied"):
        replace_file(tmp_path / "x", b"")


def test_a_read_only_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def read_only(*_: object, **__: object) -> int:
        raise OSError(30, "Read-only file system")

    monkeypatch.setattr(os, "open", read_only)
    with pytest.raises(ResultFileError, match=r"x: cannot be written: Read-only file system$"):
        replace_file(tmp_path / "x", b"")


def test_names_that_no_file_can_have(tmp_path: Path) -> None:
    for name in ("a\0b", "x" * 300, "\ud800"):
        with pytest.raises(ResultFileError, match="cannot be written"):
            replace_file(tmp_path / name, b"")
    os.mkfifo(tmp_path / "pipe")
    for path in (tmp_path / "pipe", Path("/dev/null")):
        with pytest.raises(ResultFileError, match="is a device or a pipe"):
            replace_file(path, b"")
    (tmp_path / "a").symlink_to("b")
    (tmp_path / "b").symlink_to("a")
    with pytest.raises(ResultFileError, match="cannot be written"):
        replace_file(tmp_path / "a", b"")


def test_the_longest_name_there_is(tmp_path: Path) -> None:
    path = replace_file(tmp_path / ("x" * 255), b"content")
    assert path.read_bytes() == b"content"


# What killed writers leave.


def leave(folder: Path, kernel: str = "", age: float = 0.0, name: str = "") -> Path:
    """Leave a temporary file, as somebody did `age` seconds ago."""
    path = folder / (name or f".mbocp-{kernel or atomic._kernel()}-{random.randbytes(4).hex()}.tmp")
    path.write_text("half")
    os.utime(path, (time.time() - age,) * 2)
    return path


def test_what_killed_writers_left_is_removed(tmp_path: Path) -> None:
    left = [leave(tmp_path) for _ in range(3)]
    elsewhere = leave(tmp_path, kernel="00000000", age=0.5 * DAY)
    older = leave(tmp_path, kernel="00000000", age=1.1 * DAY)
    foreign = [
        leave(tmp_path, age=9 * DAY, name=n) for n in (".x.tmp", "mbocp-01234567-01234567.tmp", "x.h5")
    ]
    before_locks = leave(tmp_path, age=9 * DAY, name=".x.h5.4711-0123abcd.tmp")
    just_now = leave(tmp_path, name=".x.h5.4711-0123abce.tmp")
    path = replace_file(tmp_path / "new", b"")
    assert not any(p.exists() for p in [*left, older, before_locks])
    assert set(tmp_path.iterdir()) == {path, elsewhere, just_now, *foreign}


def test_writers_that_are_killed_one_after_another_leave_one_file(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """As soon as their file is there, before they look at what others left."""

    def killed(folder: Path) -> tuple[Path, int]:
        leave(folder)
        raise KeyboardInterrupt

    monkeypatch.setattr(atomic, "_temporary", killed)
    for _ in range(3):
        with pytest.raises(KeyboardInterrupt):
            replace_file(tmp_path / "x", b"")
    assert len(list(tmp_path.iterdir())) == 1


def test_what_is_being_written_stays(tmp_path: Path) -> None:
    with atomic_path(tmp_path / "a") as first:
        first.write_text("first")
        replace_file(tmp_path / "b", b"second")
        assert first.exists()
    assert (tmp_path / "a").read_text() == "first"


def test_without_locks_only_what_is_old_is_removed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def no_locks(*_: object) -> None:
        raise OSError(38, "Function not implemented")

    monkeypatch.setattr(fcntl, "flock", no_locks)
    new, old = leave(tmp_path), leave(tmp_path, age=1.1 * DAY)
    replace_file(tmp_path / "x", b"")
    assert new.exists()
    assert not old.exists()


def test_links_and_folders_with_such_names_stay(tmp_path: Path) -> None:
    target = leave(tmp_path, name="precious", age=9 * DAY)
    link = tmp_path / f".mbocp-{atomic._kernel()}-00000000.tmp"
    link.symlink_to(target)
    folder = tmp_path / f".mbocp-{atomic._kernel()}-00000001.tmp"
    folder.mkdir()
    pipe = tmp_path / f".mbocp-{atomic._kernel()}-00000002.tmp"
    os.mkfifo(pipe)
    replace_file(tmp_path / "x", b"")
    assert link.is_symlink()
    assert target.exists()
    assert folder.is_dir()
    assert pipe.exists()


def test_a_temporary_file_that_was_swept_up_too_early_is_made_again(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Between the making of a file and its lock another process may take it for a rest."""
    lock, made = fcntl.flock, []

    def late(handle: int, kind: int) -> None:
        if not made:
            made.extend(tmp_path.glob(".mbocp-*"))
            made[0].unlink()
        lock(handle, kind)

    monkeypatch.setattr(fcntl, "flock", late)
    assert replace_file(tmp_path / "x", b"content").read_bytes() == b"content"
    assert [p.name for p in tmp_path.iterdir()] == ["x"]


# Savers that are killed, or that save the same file. Forks of one process, because to import takes a second.

BEGIN = """
import os, random, signal, sys, time
from pathlib import Path
from mbocp.solution import Solution
from tests.solution.fabricated import arm

path, times = Path(sys.argv[1]), int(sys.argv[2])

def start(num_steps, count):
    solution = arm(num_steps=num_steps, advice=str(num_steps))
    child = os.fork()
    if child == 0:
        signal.signal(signal.SIGINT, signal.default_int_handler)
        try:
            for _ in range(count):
                solution.save(path)
        except KeyboardInterrupt:
            os._exit(130)
        os._exit(0)
    return child
"""

KILL = (
    BEGIN
    + """
draw, rests, saved = random.Random(times), 0, arm(num_steps=100, advice="100")
saved.save(path)
for _ in range(times):
    child = start(100, 10**9)
    time.sleep(draw.uniform(0.0, 0.1))
    gone = 0
    while not gone:  # an interrupt in the midst of HDF5's destructors is lost
        os.kill(child, int(sys.argv[3]))
        time.sleep(0.01)
        gone, status = os.waitpid(child, os.WNOHANG)
    assert os.waitstatus_to_exitcode(status) in map(int, sys.argv[4:]), status
    rests = max(rests, len(list(path.parent.iterdir())) - 1)
    assert Solution.load(path) == saved
saved.save(path)
assert list(path.parent.iterdir()) == [path]
print(rests)
"""
)

RACE = (
    BEGIN
    + """
children = [start(num_steps, times) for num_steps in (50, 60)]
looks = 0
while children:
    child, status = os.waitpid(-1, os.WNOHANG)
    assert status == 0
    children = [c for c in children if c != child]
    if path.exists():
        found = Solution.load(path)
        assert found.advice == str(found.num_steps)
        looks += 1
assert list(path.parent.iterdir()) == [path]
print(looks)
"""
)


def printed(script: str, *arguments: object) -> int:
    """The number that a script prints."""
    command = [sys.executable, "-c", script, *map(str, arguments)]
    ended = subprocess.run(command, check=False, capture_output=True, text=True, timeout=300)
    assert ended.returncode == 0, ended.stderr
    return int(ended.stdout)


@pytest.mark.parametrize("times", [8, pytest.param(200, marks=pytest.mark.slow)])
def test_a_killed_saver_leaves_a_whole_file_and_one_rest_at_most(times: int, tmp_path: Path) -> None:
    assert printed(KILL, tmp_path / "result.h5", times, int(signal.SIGKILL), -signal.SIGKILL) <= 1


@pytest.mark.parametrize("times", [8, pytest.param(200, marks=pytest.mark.slow)])
def test_an_interrupted_saver_leaves_a_whole_file(times: int, tmp_path: Path) -> None:
    ends = (130, -signal.SIGINT)  # within a save, or before the first one and after the last
    assert printed(KILL, tmp_path / "result.h5", times, int(signal.SIGINT), *map(int, ends)) <= 1


@pytest.mark.parametrize("times", [20, pytest.param(500, marks=pytest.mark.slow)])
def test_savers_of_one_file_leave_that_of_one_of_them(times: int, tmp_path: Path) -> None:
    assert printed(RACE, tmp_path / "result.h5", times) > 0
