"""When a path constraint holds."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Annotated, Any, Literal, NamedTuple, TypeAlias

import numpy as np
from pydantic import create_model

from mbocp._arrays import BoolArray, dataclass
from mbocp._keys import Key, Kind, Table
from mbocp._quantities import finite_number, is_number
from mbocp._text import show
from mbocp.exceptions import InvalidValue, ProblemError

_GRAIN = 1e-6  # of a step: times closer to a node than this are the node's


@dataclass(frozen=True)
class Share:
    """An end of a span as a part of the horizon.

    Attributes
    ----------
    value : float
        Between 0 and 1.
    """

    value: float


@dataclass(frozen=True)
class AtVia:
    """An end of a span at a via point, or in a phase, whenever the motion is there.

    Attributes
    ----------
    name : str
    node : int
        Where it is; 0 until the problem says it.
    share : float, optional
        Part of a phase that is over; None: a via point, or the beginning or the end of a phase.
    """

    name: str
    node: int = 0
    share: float | None = None


class NodePlace(NamedTuple):
    """Nodes of a via point or a phase.

    Attributes
    ----------
    first, last : int
    num_untimed : int
        How many of its last steps take no time.
    """

    first: int
    last: int
    num_untimed: int = 0

    def at(self, share: float) -> int:
        """Node at which a part of it is over; its last one for 1."""
        timed = self.last - self.num_untimed - self.first
        return self.last if share >= 1.0 else self.first + round(share * timed)


End: TypeAlias = float | Share | AtVia | None


def end_from(written: Any) -> End:
    """An end as people write it: a time [s], the name of a via point or a phase, or a table with a share.

    Raises
    ------
    ValueError
        If it is none of them.
    """
    if written is None or isinstance(written, (Share, AtVia)):
        return written
    if isinstance(written, str):
        return AtVia(written)
    if isinstance(written, Mapping) and set(written) == {"share"}:
        return Share(finite_number(written["share"], " for share"))
    names_phase = isinstance(written, Mapping) and isinstance(written.get("phase"), str)
    if names_phase and set(written) == {"phase", "share"}:
        return AtVia(written["phase"], share=finite_number(written["share"], " for share"))
    if isinstance(written, Mapping):
        raise ValueError(
            f"got {show(written)}, expected a time [s], the name of a via point or of a phase, "
            "{ share = number }, or { phase = name, share = number }"
        )
    return finite_number(written)


SPAN = ("from", "until")  # its keys in a problem file
_End = Annotated[
    Any,
    Kind(
        "number, name, or `{ phase, share }`",
        end_from,
        float | str | dict[Literal["phase", "share"], float | str],
    ),
]
_KEY = Key(
    "when it holds: [times, via points, phases](#path-constraints)", "s", "the whole motion", beside=SPAN[1:]
)
_FIELDS: Any = {"from": (Annotated[_End, _KEY], None), "until": (_End, None)}
SpanKeys = create_model("SpanKeys", __base__=Table, __doc__="When a path constraint holds.", **_FIELDS)


@dataclass(frozen=True)
class Span:
    """A part of the horizon, both ends included.

    Attributes
    ----------
    since, until : float, Share, AtVia or None
        A time [s], a part of the horizon, a via point; None: the start, and the end of the motion.
    """

    since: End = None
    until: End = None

    @property
    def has_start(self) -> bool:
        """Whether the start belongs to it."""
        return self.since in (None, 0.0, Share(0.0))

    def has_end(self, num_steps: int, dt: float) -> bool:
        """Whether the last node belongs to it."""
        return bool(self.nodes(num_steps, dt)[-1])

    @classmethod
    def at_node(cls, node: int) -> Span:
        """Return one node alone."""
        return cls(AtVia("", node), AtVia("", node))

    @classmethod
    def at_end(cls) -> Span:
        """Return the last node alone, whatever the duration."""
        return cls(since=Share(1.0))

    @classmethod
    def read(cls, table: Table) -> Span:
        """From a table that has its keys."""
        return cls(*(getattr(table, key) for key in SPAN))

    def write(self) -> dict[str, Any]:
        """Keys that read back as the same."""
        pairs = zip(SPAN, (self.since, self.until), strict=True)
        return {key: _write(end) for key, end in pairs if end is not None}

    @property
    def via_names(self) -> tuple[str, ...]:
        """Via points and phases at its ends."""
        return tuple(end.name for end in (self.since, self.until) if isinstance(end, AtVia))

    @property
    def has_times(self) -> bool:
        """Whether it begins or ends at a time, so that its nodes depend on the lengths of the steps."""
        return any(is_number(end) and end > 0.0 for end in (self.since, self.until))

    def at_via(self, nodes: Mapping[str, NodePlace], key: str) -> Span:
        """The same with the nodes of via points and phases by name: where each begins, and where it ends.

        Raises
        ------
        ProblemError
            If there is none of a name, or the second is before the first.
        """
        ends = [self.since, self.until]
        for i, end in enumerate(ends):
            if isinstance(end, AtVia):
                if end.name not in nodes:
                    known = ", ".join(map(repr, nodes)) or "none"
                    raise ProblemError(
                        f"{key}: {SPAN[i]}: no via point or phase {end.name!r}; there are {known}: give "
                        "one of them, a time [s], or { share = number }"
                    )
                share = float(i) if end.share is None else end.share
                ends[i] = replace(end, node=nodes[end.name].at(share))
        return Span(*ends)

    def nodes(self, num_steps: int, dt: float) -> BoolArray:
        """Which of the nodes 1..N belong to it, shape (N,)."""
        n = np.arange(1, num_steps + 1, dtype=np.float64)
        first, last = (_place(end, num_steps, dt) for end in (self.since, self.until))
        return (n >= (-np.inf if first is None else first - _GRAIN)) & (
            n <= (np.inf if last is None else last + _GRAIN)
        )

    def check(self, key: str) -> None:
        """Refuse what are no times in their order.

        Raises
        ------
        InvalidValue
            If one is no number of seconds from the start, no share, or the second is before the first.
        """
        for name, end in zip(SPAN, (self.since, self.until), strict=True):
            _check_end(end, f"{key}: {name}")
        since, until = self.since, self.until
        if isinstance(since, float | int) and isinstance(until, float | int) and until < since:
            raise InvalidValue(f"{key}: until", until, f"a time not before from = {since:g} [s]")
        if isinstance(since, Share) and isinstance(until, Share) and until.value < since.value:
            raise InvalidValue(f"{key}: until", until.value, f"a share not below from = {since.value:g}")

    def check_horizon(self, key: str, num_steps: int, dt: float, *, num_lengths: int) -> None:
        """Refuse times outside a horizon, those without a node between them, and what a free one leaves open.

        Parameters
        ----------
        num_lengths : int
            Of steps whose length is found with the motion, or differs; 0: all are given and the same.

        Raises
        ------
        InvalidValue, ProblemError
        """
        for name, end in zip(SPAN, (self.since, self.until), strict=True):
            _check_end_within(end, f"{key}: {name}", num_steps, dt, num_lengths)
        if not self.nodes(num_steps, dt).any():
            since, until = (_words(end) for end in (self.since or 0.0, self.until))
            apart = "" if num_lengths else f"; nodes are {dt:g} s apart"
            raise ProblemError(
                f"{key}: no node after the start is between from = {since} and until = {until}{apart}: take "
                "times farther apart, or those of a node"
            )


def _check_end(end: End, key: str) -> None:
    """Refuse what is no share, and no time from the start on."""
    if isinstance(end, Share):
        if not (is_number(end.value) and 0.0 <= end.value <= 1.0):
            raise InvalidValue(key, show(end.value), "a part of the horizon, 0 <= share <= 1")
    elif isinstance(end, AtVia):
        if end.share is not None and not 0.0 <= end.share <= 1.0:
            raise InvalidValue(key, end.share, "a part of the phase, 0 <= share <= 1")
    elif end is not None and not (is_number(end) and np.isfinite(end) and end >= 0.0):
        raise InvalidValue(key, show(end), "a time from the start on [s], at least 0")


def _check_end_within(end: End, key: str, num_steps: int, dt: float, num_lengths: int) -> None:
    """Refuse a time, or a share, that says no node: outside the horizon, or of steps that are not known."""
    if num_lengths > 1 and isinstance(end, Share) and 0.0 < end.value < 1.0:
        raise ProblemError(
            f"{key}: a share of equal steps, and lengths of steps are free or differ; name a via point or a "
            "phase"
        )
    if not is_number(end) or end == 0.0:
        return
    if num_lengths:
        more = ", or give { share = number }" if num_lengths == 1 else ", which may be of free time"
        raise ProblemError(
            f"{key}: a time of given steps, and lengths of steps are free or differ; name a via point or a "
            f"phase{more}"
        )
    duration = num_steps * dt
    if end > duration + _GRAIN * dt:
        raise InvalidValue(key, end, f"a time within the horizon of {duration:g} s")


def _place(end: End, num_steps: int, dt: float) -> float | None:
    """Which node is meant; between two, a number between theirs."""
    if isinstance(end, AtVia):
        return float(end.node)
    if isinstance(end, Share):
        return end.value * num_steps
    return None if end is None else end / dt


def _write(end: End) -> Any:
    if isinstance(end, AtVia):
        return end.name if end.share is None else {"phase": end.name, "share": end.share}
    return {"share": end.value} if isinstance(end, Share) else end


def _words(end: End) -> str:
    if isinstance(end, AtVia):
        return f"via {end.name!r}" if end.share is None else f"share {end.share:g} of phase {end.name!r}"
    if isinstance(end, Share):
        return f"share {end.value:g}"
    return "the end" if end is None else f"{end:g} s"
