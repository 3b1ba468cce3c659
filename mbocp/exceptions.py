"""Every error that mbocp raises on purpose: one root, then one branch a layer.

An error says what is wrong, where, and what to do about it, and carries the data as attributes. Its class is
its code, and `key` the place: programs ask for these, and for no words.
"""

from __future__ import annotations

import difflib
import re
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import AbstractContextManager, contextmanager
from pathlib import Path
from typing import Any

from mbocp._text import MAX_MESSAGE, shorten, show


def suggest(name: str, valid: Iterable[str], limit: int = 12) -> str:
    """Return "did you mean ...?" for a near miss in whatever case, else the (shortened) valid names."""
    names = list(valid)
    if not names:
        return "there is none"
    folded = {one.casefold(): one for one in reversed(names)}
    close = [folded[one] for one in difflib.get_close_matches(name.casefold(), folded, n=3)]
    if close:
        return f"did you mean {' or '.join(repr(shorten(c)) for c in close)}?"
    first = ", ".join(shorten(name) for name in names[:limit])
    return f"valid names: {first}{', ...' if len(names) > limit else ''}"


_MOST_LISTED = 3  # excesses in a message
# A dotted key or the name of an argument at the beginning of a message, as in "goal.q[2]: got ...".
_KEY = re.compile(r"([a-z_]\w*(?:\.\w+|\[[\w, ]+\])*): ")


def key_in(message: str) -> str | None:
    """Return the dotted key, or the name of the argument, that a message begins with."""
    found = _KEY.match(message)
    return found[1] if found else None


class MbocpError(Exception):
    """Root of all errors of mbocp; a message has at most `MAX_MESSAGE` characters, whatever it quotes."""

    _key: str | None = ""  # "": what the message begins with

    def __init__(self, *words: Any) -> None:
        super().__init__(*(shorten(w, MAX_MESSAGE) if isinstance(w, str) else w for w in words))

    def __reduce__(self) -> tuple[Any, ...]:
        """As they are, not by their constructors: errors of other processes arrive as they were raised."""
        return _restore, (type(self), self.args), self.__dict__

    @property
    def key(self) -> str | None:
        """Key of a file, or argument of a function, that the error is about; None where it names none."""
        return self._key if self._key != "" else key_in(str(self))

    def put_into(self, path: Path | str) -> None:
        """Put the name of the file in front of the message, unless it is there."""
        if not str(self).startswith(f"{path}: "):
            self._key = self.key
            self.args = (f"{path}: {self}",)


def _restore(kind: type[MbocpError], words: tuple[Any, ...]) -> MbocpError:
    error = kind.__new__(kind)
    error.args = words
    return error


@contextmanager
def reword_errors(change: Callable[[str], str], *kinds: type[MbocpError]) -> Iterator[None]:
    """Change the message of every error from the block, of some kinds or of all."""
    try:
        yield
    except MbocpError as error:
        if isinstance(error, kinds or MbocpError):
            error.args = (change(str(error)),)
        raise


def locate(key: str, *kinds: type[MbocpError]) -> AbstractContextManager[None]:
    """Put the `key` in front of the message of every error from the block, unless it is there."""
    is_there = rf"{re.escape(key)}[:.\[]"
    return reword_errors(lambda words: words if re.match(is_there, words) else f"{key}: {words}", *kinds)


class Unreadable(MbocpError):
    """A file or text that cannot be read as what it should be; who names the file adds `reason` to it."""

    def __init__(self, reason: str) -> None:
        self.reason = reason
        super().__init__(reason)


class _FileError(MbocpError):
    """Something about a file, and a key in it where there is one."""

    def __init__(self, path: Path | str, reason: str, key: str | None = None) -> None:
        self.path, self.reason, self._key = Path(path), reason, key
        super().__init__(f"{path}: {f'{key}: ' if key else ''}{reason}")

    @classmethod
    @contextmanager
    def where_unreadable(cls, path: Path | str) -> Iterator[None]:
        """Around the reading of a file: what is `Unreadable` there ends in this error, which names it."""
        try:
            yield
        except Unreadable as error:
            raise cls(path, error.reason) from error


class DimensionMismatch(MbocpError):
    """An array does not have the shape that the robot or problem asks for."""

    def __init__(
        self, name: str, got: Sequence[int] | int, expected: Sequence[int | None] | int, hint: str = ""
    ) -> None:
        self.name, self.got, self.expected = name, got, expected
        super().__init__(
            f"{name}: got shape {_shape(got)}, expected {_shape(expected)}{'; ' + hint if hint else ''}"
        )


class InvalidValue(MbocpError):
    """A number that cannot be right: NaN, infinite, negative where it must be positive."""

    def __init__(self, name: str, got: Any, expected: str) -> None:
        self.name, self.got, self.expected = name, got, expected
        super().__init__(f"{name}: got {got}, expected {expected}")

    @classmethod
    def of_choice(cls, name: str, got: Any, allowed: Sequence[str], note: str = "") -> InvalidValue:
        """Return the error for a word that is none of the `allowed` ones: it lists them, the nearest too."""
        listed = " | ".join(f'"{word}"' for word in allowed)
        hint = suggest(got, allowed) if isinstance(got, str) else ""
        near = f" ({hint})" if hint.startswith("did you mean") else ""
        return cls(name, show(got), f"{listed}{near}{'; ' + note if note else ''}")

    @classmethod
    def of_literal(cls, error: Mapping[str, Any]) -> InvalidValue:
        """Return the error for pydantic's of a word that is none of a Literal."""
        words = re.findall("'(.*?)'", error["ctx"]["expected"])
        return cls.of_choice(".".join(map(str, error["loc"])), error["input"], words)

    @classmethod
    def of_missing(cls, extra: str, error: ImportError) -> InvalidValue:
        """Return the error for a format whose package is not installed."""
        return cls("format", extra, f"an extra to be installed ({error}): pip install 'mbocp[{extra}]'")


class MemoryLimitExceeded(MbocpError):
    """Something that would take more memory than the limit allows; nothing was allocated for it.

    `needed` and `limit` are in bytes.
    """

    def __init__(self, what: str, needed: float, limit: float, source: str, remedy: str) -> None:
        self.what, self.needed, self.limit = what, needed, limit
        super().__init__(
            f"{what} would take about {_bytes(needed)} of memory; the limit is {_bytes(limit)} ({source}). "
            f"{remedy}, or set MBOCP_MEMORY_LIMIT to as many MB as it may take"
        )


class RobotError(MbocpError):
    """Something about the robot's model."""


class UnknownRobot(RobotError):
    """No robot of that name, and no such file."""

    def __init__(
        self, name: str, valid: Iterable[str], folder: str = "", *, has_profile: bool = False
    ) -> None:
        self.name, self.valid = name, tuple(valid)
        found = f"did you mean the folder {folder!r}?" if folder else suggest(name, self.valid)
        if has_profile:
            found = f"limits.profile knows it, but its model is none of those that come with mbocp; {found}"
        super().__init__(
            f"unknown robot {name!r}: {found} (run `mbocp robots` for the whole list, "
            "or give the path of a URDF or robot.toml)"
        )


class RobotFileError(_FileError, RobotError):
    """A URDF, robot.toml or package folder that cannot be read or does not say what it must."""


class UnknownJoint(RobotError):
    """A joint name that the robot does not have, or, for a `reason`, not with numbers of its own."""

    def __init__(self, name: str, robot: str, valid: Iterable[str], reason: str = "") -> None:
        self.name, self.robot, self.valid = name, robot, tuple(valid)
        unknown = f"robot {robot!r} has no joint {shorten(name)!r}: {suggest(name, self.valid)}"
        super().__init__(f"joint {shorten(name)!r} of robot {robot!r} {reason}" if reason else unknown)


class UnknownFrame(RobotError):
    """A frame name that the robot does not have."""

    def __init__(self, name: str, robot: str, valid: Iterable[str]) -> None:
        self.name, self.robot, self.valid = name, robot, tuple(valid)
        tips_first = suggest(name, reversed(self.valid))
        super().__init__(f"robot {robot!r} has no frame {shorten(name)!r}: {tips_first}")


class UnsupportedRobot(RobotError):
    """A feature of the robot that mbocp does not support, by name."""


class LoopNotClosed(RobotError):
    """Holonomic constraints that no configuration near the given one fulfils.

    `rows` has the names of the rows that stay violated, the worst first, and `residual` by how much.
    """

    def __init__(self, robot: str, rows: Sequence[str], residual: Sequence[float], words: str) -> None:
        self.robot, self.rows, self.residual = robot, tuple(rows), tuple(residual)
        super().__init__(f"robot {robot!r}: {words}")


class ProblemError(MbocpError):
    """Something about the optimal control problem."""


class ProblemFileError(_FileError, ProblemError):
    """A problem file that is missing, malformed, or has wrong keys or values.

    `mistakes` has the key, or None, and the words for each; `key` is that of the first.
    """

    def __init__(
        self, path: Path | str, reason: str, key: str | None = None, others: Sequence[tuple[str, str]] = ()
    ) -> None:
        self.mistakes: tuple[tuple[str | None, str], ...] = ((key, reason), *others)
        rest = "".join(f"\n{path}: {other}: {words}" for other, words in others)
        super().__init__(path, reason + rest, key)


class InconsistentStart(ProblemError):
    """The start (or goal) violates a holonomic constraint, at position or velocity level."""


class UnreachableGoal(ProblemError):
    """A goal to which a mechanism with closed loops does not get from the start."""


class UnreachablePose(UnreachableGoal):
    """A pose of a frame that no configuration within the limits has.

    Attributes
    ----------
    robot, frame : str
    distance : float
        How far the frame's origin is from its target at the best try [m].
    angle : float
        The angle that is left there [rad].
    joints : tuple of str
        Joints that are at a limit there.
    q : ndarray, shape (nq,)
        The best try.
    """

    def __init__(
        self, robot: str, frame: str, distance: float, angle: float, joints: Sequence[str], q: Any, words: str
    ) -> None:
        self.robot, self.frame, self.distance, self.angle = robot, frame, distance, angle
        self.joints, self.q = tuple(joints), q
        super().__init__(words)


class OverdeterminedGoal(ProblemError):
    """More exact end conditions than the system can meet."""


class TranscriptionError(MbocpError):
    """Something about turning the problem into compiled stage functions."""


class CompilationError(TranscriptionError):
    """The C compiler refused a generated stage function."""


class CompilationTimeout(CompilationError):
    """The time limit of a solve passed before its stage functions were there; `doing` says at what."""

    def __init__(self, doing: str) -> None:
        self.doing = doing
        super().__init__(
            f"solver.time_limit passed while {doing}: no iteration was taken. Raise it; the functions are "
            "kept once they are compiled, so that later runs of this shape begin at once"
        )


class TooManyOperations(TranscriptionError):
    """Functions of a stage that would take too long to build and to compile."""

    def __init__(self, robot: str, nv: int, operations: float, limit: float, remedy: str) -> None:
        self.operations, self.limit = operations, limit
        super().__init__(
            f"the functions of a stage of robot {robot!r} (nv = {nv}) would have about {operations:.2g} "
            f"operations; the limit is {limit:.2g}. {remedy}, or set MBOCP_OPERATIONS_LIMIT to as many as "
            "there may be"
        )


class NativeMismatch(MbocpError):
    """The native part does not fit the installed Pinocchio or CasADi."""


class SolverError(MbocpError):
    """Something about the numbers."""


class SingularSystem(SolverError):
    """A linear system without a unique solution."""


class NotConverged(SolverError):
    """`solve(..., check=True)` did not converge; the best iterate is in `solution`."""

    def __init__(self, solution: Any) -> None:
        self.solution = solution
        super().__init__(f"{solution.status}: {solution.advice}")


class ResultFileError(_FileError):
    """A result file that cannot be read or written."""


class LogError(_FileError):
    """A log of a robot that cannot be read, or does not say what is needed."""


class LimitsExceeded(MbocpError):
    """A motion leaves its limits as it is sent; no file was written.

    `excesses` has each limit that is left, with joint, value and time: `mbocp.solution.joints_sent.Excess`.
    """

    def __init__(self, path: Path | str, excesses: Sequence[Any], remedy: str) -> None:
        self.path, self.excesses = Path(path), tuple(excesses)
        listed = "; ".join(f"{excess.name}: {excess.words}" for excess in excesses[:_MOST_LISTED])
        listed += f"; and {len(excesses) - _MOST_LISTED} more" if len(excesses) > _MOST_LISTED else ""
        super().__init__(
            f"{path}: not written, the motion leaves its limits as it is sent: {listed}; {remedy}; "
            "check=False writes it all the same"
        )


class StudyError(MbocpError):
    """Something about many problems at once: their table, or the executor that runs them."""


class StudyFileError(_FileError, StudyError):
    """A study file that is missing, malformed, or has a wrong key or value."""


class ReplayError(MbocpError):
    """A replay that cannot be written or shown."""


def _bytes(number: float) -> str:
    return f"{number / 1e9:.3g} GB" if number >= 1e9 else f"{number / 1e6:.3g} MB"


def _shape(value: Sequence[int | None] | int) -> str:
    if isinstance(value, int):
        return f"({value},)"
    inner = ", ".join("any" if v is None else str(v) for v in value)
    return f"({inner}{',' if len(value) == 1 else ''})"
