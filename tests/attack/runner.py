"""Processes that throw inputs, each under limits; a process that is lost costs one input."""

from __future__ import annotations

import json
import os
import resource
import selectors
import shutil
import signal
import tempfile
import time
import traceback
import warnings
from collections.abc import Callable, Iterable, Iterator
from dataclasses import asdict, dataclass, field
from pathlib import Path

from mbocp._text import MAX_MESSAGE
from mbocp.exceptions import MbocpError

from .cases import Case, make_case
from .targets import TARGETS, Broken, Refused

__all__ = ["LIMITS", "Limits", "Outcome", "attack", "throw"]

_CHUNK = 200  # inputs of a process
_PERIOD = 0.25  # [s] between two looks at the clocks
_TICKS = os.sysconf("SC_CLK_TCK")
_PACKAGE = f"{os.sep}mbocp{os.sep}"


@dataclass(frozen=True)
class Limits:
    """What an input may cost."""

    cpu: float = 10.0  # [s]
    wall: float = 120.0  # [s]; the machine may have other things to do
    address_space: int = 6 << 30  # [bytes] of the process: beyond it, allocations fail
    memory: int = 1 << 30  # [bytes] that become resident beyond what was before
    patience: int = 4  # times so long for an input that is solved: its functions are written first
    message: int = MAX_MESSAGE + 200  # letters of an error or a warning, with the note that it was cut


LIMITS = Limits()


@dataclass
class Outcome:
    """What came of an input: "accepted", "refused", or the class of a finding."""

    kind: str
    seed: int
    verdict: str
    where: str = ""
    text: str = ""
    seconds: float = 0.0
    peak: int = 0  # [bytes] resident beyond what was before
    entry: str = ""
    warned: list[str] = field(default_factory=list)

    @property
    def is_finding(self) -> bool:
        """Whether it is neither a result nor an error of ours."""
        return self.verdict not in ("accepted", "refused")


def throw(case: Case, folder: Path, limits: Limits = LIMITS) -> Outcome:
    """Throw one input, in this process."""
    outcome = Outcome(case.kind, case.seed, "accepted", entry=case.entry)
    before = _reset_peak()
    begun = time.perf_counter()
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        try:
            path = case.write(folder)
            TARGETS[case.kind](case, path)
        except (MbocpError, Refused) as error:
            outcome.verdict, outcome.text = "refused", str(error)
            outcome.where = type(error).__name__
        except Broken as error:
            outcome.verdict, outcome.text, outcome.where = "broken", str(error), str(error)[:100]
        except BaseException as error:
            outcome.verdict, outcome.where = "traceback", _place(error)
            outcome.text = f"{type(error).__name__}: {str(error)[:300]}"
    outcome.seconds = time.perf_counter() - begun
    outcome.peak = max(0, _peak() - before)
    _judge(outcome, caught, limits)
    return outcome


def _judge(outcome: Outcome, caught: list[warnings.WarningMessage], limits: Limits) -> None:
    """Turn what came in time, but not as promised, into a finding."""
    outcome.warned = sorted({type(w.message).__name__ for w in caught})
    if outcome.is_finding:
        return
    foreign = [w for w in caught if not _is_ours(w)]
    longest = max([outcome.text, *(str(w.message) for w in caught)], key=len)
    if foreign:
        worst = foreign[0]
        outcome.verdict = "foreign warning"
        outcome.where = f"{worst.category.__name__} {Path(worst.filename).name}:{worst.lineno}"
        outcome.text = str(worst.message)[:300]
    elif len(longest) > limits.message:
        outcome.verdict, outcome.where = (
            "long message",
            f"{outcome.where}: {longest.rpartition(os.sep)[2][:60]}",
        )
        outcome.text = f"{len(longest)} letters: {longest[:300]}"
    elif outcome.peak > limits.memory:
        outcome.verdict, outcome.where = "memory", outcome.where or "accepted"
        outcome.text = f"{outcome.peak / 1e6:.0f} MB; {outcome.text[:300]}"


def _is_ours(warning: warnings.WarningMessage) -> bool:
    return warning.category is UserWarning or warning.category.__module__.startswith("mbocp")


def _place(error: BaseException) -> str:
    """Type of the error, and the last line of mbocp that it came through."""
    frames = traceback.extract_tb(error.__traceback__)
    ours = [frame for frame in frames if _PACKAGE in frame.filename and "tests" not in frame.filename]
    if not ours:
        return f"{type(error).__name__} outside of mbocp"
    inner = ours[-1]
    return f"{type(error).__name__} {inner.filename.rpartition(_PACKAGE)[2]}:{inner.lineno} {inner.name}"


def _reset_peak() -> int:
    """Begin to measure the peak anew; what is resident now [bytes]."""
    Path("/proc/self/clear_refs").write_text("5")
    return _peak()


def _peak() -> int:
    for line in Path("/proc/self/status").read_text().splitlines():
        if line.startswith("VmHWM"):
            return int(line.split()[1]) * 1024
    return 0


class _Worker:
    """A forked process that throws a row of inputs and says of each when it begins and what came of it."""

    def __init__(self, todo: list[tuple[str, int]], limits: Limits, make: Callable[[str, int], Case]) -> None:
        self.todo, self.limits = todo, limits
        self.now: tuple[str, int] | None = None
        self.begun, self.cpu = 0.0, 0.0
        self.was_killed = False
        self.folder = Path(tempfile.mkdtemp(prefix="attack-", dir=_memory()))
        self._buffer = b""
        self.reader, writer = os.pipe()
        self.pid = os.fork()
        if self.pid == 0:
            os.close(self.reader)
            _serve(todo, writer, self.folder, limits, make)
        os.close(writer)

    def read(self) -> tuple[list[Outcome], bool]:
        """What came since, and whether the process has ended."""
        chunk = os.read(self.reader, 1 << 16)
        self._buffer += chunk
        *lines, self._buffer = self._buffer.split(b"\n")
        found = []
        for line in lines:
            if line.startswith(b"+"):
                kind, _, seed = line[1:].decode().partition(" ")
                self.now, self.begun, self.cpu = (kind, int(seed)), time.monotonic(), _cpu(self.pid)
            else:
                outcome = Outcome(**json.loads(line))
                if self.was_killed and (outcome.kind, outcome.seed) not in self.todo:
                    continue  # it ended while it was being killed, and counts as too late
                found.append(outcome)
                self.todo.remove((outcome.kind, outcome.seed))
                self.now = None
        return found, not chunk

    def overtime(self) -> Outcome | None:
        """Kill it if the input under way has cost more than it may."""
        if self.now is None:
            return None
        cpu, wall = _cpu(self.pid) - self.cpu, time.monotonic() - self.begun
        times = self.limits.patience if self.now[0] == "solve" else 1
        if cpu <= times * self.limits.cpu and wall <= times * self.limits.wall:
            return None
        os.kill(self.pid, signal.SIGUSR1)  # faulthandler writes where it is
        time.sleep(0.2)
        os.kill(self.pid, signal.SIGKILL)
        self.was_killed = True
        text = f"{cpu:.0f} s of the processor, {wall:.0f} s in all: {self._stack()}"
        outcome = Outcome(*self.now, "hang", self._stack()[:80], text, wall)
        return self._lost(outcome)

    def ended(self) -> Outcome | None:
        """The finding, if the process was lost with an input under way."""
        _, status = os.waitpid(self.pid, 0)
        os.close(self.reader)
        lost = None
        if self.now is not None:
            code = os.waitstatus_to_exitcode(status)
            word = signal.Signals(-code).name if code < 0 else f"exit {code}"
            lost = self._lost(Outcome(*self.now, "crash", f"{word} {self._stack()[:80]}", self._stack()))
        elif status != 0 and not self.was_killed:
            raise RuntimeError(f"the attack itself failed before {self.todo[0]}:\n{self._said()}")
        shutil.rmtree(self.folder, ignore_errors=True)
        self.folder.with_suffix(".err").unlink(missing_ok=True)
        return lost

    def _lost(self, outcome: Outcome) -> Outcome:
        self.todo.remove((outcome.kind, outcome.seed))
        self.now = None
        return outcome

    def _said(self) -> str:
        return self.folder.with_suffix(".err").read_text(errors="replace")

    def _stack(self) -> str:
        """Innermost lines of mbocp, as faulthandler wrote them."""
        lines = [
            line.strip() for line in self._said().splitlines() if _PACKAGE in line and "/tests/" not in line
        ]
        return " < ".join(line.rpartition(_PACKAGE)[2] for line in lines[:3])


def _serve(
    todo: Iterable[tuple[str, int]],
    writer: int,
    folder: Path,
    limits: Limits,
    make: Callable[[str, int], Case],
) -> None:
    """Throw the inputs; never returns."""
    import faulthandler

    code = 1
    try:
        noise = open(folder.with_suffix(".err"), "w+b", buffering=0)  # noqa: SIM115, PTH123
        os.dup2(noise.fileno(), 2)
        null = os.open(os.devnull, os.O_WRONLY)
        os.dup2(null, 1)
        faulthandler.enable(file=noise)
        faulthandler.register(signal.SIGUSR1, file=noise)
        resource.setrlimit(resource.RLIMIT_AS, (limits.address_space, limits.address_space))
        resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
        for kind, seed in list(todo):
            inner = folder / "input"
            inner.mkdir()
            case = make(kind, seed)
            noise.truncate(0)
            noise.seek(0)
            os.write(writer, f"+{kind} {seed}\n".encode())
            os.chdir(inner)
            outcome = throw(case, inner, limits)
            said = os.pread(noise.fileno(), 2000, 0).decode(errors="replace")
            if said.strip() and not outcome.is_finding:
                outcome.verdict, outcome.where, outcome.text = "noise", said.strip()[:60], said
            os.chdir(folder)
            shutil.rmtree(inner)
            os.write(writer, json.dumps(asdict(outcome)).encode() + b"\n")
        code = 0
    except BaseException:
        traceback.print_exc()
    finally:
        os._exit(code)


def _memory() -> str | None:
    """Folder in memory, where there is one: files are flushed to the disk there without waiting."""
    return "/dev/shm" if os.access("/dev/shm", os.W_OK) else None


def _cpu(pid: int) -> float:
    """Processor time of a process and of the children that it has waited for [s]."""
    try:
        fields = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
    except OSError:
        return 0.0
    return sum(int(fields[i]) for i in (11, 12, 13, 14)) / _TICKS


def attack(
    inputs: Iterator[tuple[str, int]],
    processes: int,
    *,
    limits: Limits = LIMITS,
    make: Callable[[str, int], Case] = make_case,
) -> Iterator[Outcome]:
    """Throw all inputs; outcomes in the order in which they come."""
    running: dict[int, _Worker] = {}
    waiting: list[list[tuple[str, int]]] = []
    with selectors.DefaultSelector() as selector:
        while True:
            while len(running) < processes and (chunk := waiting.pop() if waiting else _take(inputs)):
                worker = _Worker(chunk, limits, make)
                running[worker.reader] = worker
                selector.register(worker.reader, selectors.EVENT_READ)
            if not running:
                return
            for key, _ in selector.select(_PERIOD):
                worker = running[key.fd]
                outcomes, is_over = worker.read()
                yield from outcomes
                if is_over:
                    selector.unregister(key.fd)
                    del running[key.fd]
                    if lost := worker.ended():
                        yield lost
                    if worker.todo:
                        waiting.append(worker.todo)
            yield from (late for worker in running.values() if (late := worker.overtime()) is not None)


def _take(inputs: Iterator[tuple[str, int]]) -> list[tuple[str, int]]:
    return [one for _, one in zip(range(_CHUNK), inputs, strict=False)]
