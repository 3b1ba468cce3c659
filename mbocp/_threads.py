"""Pieces of work side by side in threads, with what they come to when one follows the other."""

from __future__ import annotations

import threading
from collections.abc import Callable
from typing import Any, Generic, TypeVar

T = TypeVar("T")
Callback = Callable[[Any], object]


class Watch:
    """The callback of a piece of work: it ends a piece that nobody waits for any more.

    What it is called with goes on to another callback, at once or later.
    """

    def __init__(self, callback: Callback | None, *, is_live: bool) -> None:
        self.is_live, self.is_ended = is_live, False
        self.at_end: Callable[[], object] = lambda: None
        self._callback = callback
        self._later: list[object] = []

    def __call__(self, record: object) -> None:
        """Raise what Ctrl-C raises, where the piece is to end."""
        if self.is_ended:
            raise KeyboardInterrupt
        if self._callback is not None and self.is_live:
            self._callback(record)
        elif self._callback is not None:
            self._later.append(record)

    def end(self) -> None:
        """End the piece of work, and what `at_end` ends for it at once."""
        self.is_ended = True
        self.at_end()

    def show(self) -> None:
        """Hand on what has been kept for later."""
        while self._later and self._callback is not None:
            self._callback(self._later.pop(0))


def _never(_: object) -> bool:
    return False


class SideBySide(Generic[T]):
    """Pieces of work 0, 1, 2, ... of which none is wanted after the first that ends them all.

    The calling thread takes the first piece; it and others take one after the other. What they come to does
    not depend on who is quicker: a piece is given up only if an earlier one has ended all, and what is raised
    is what the earliest raises. With Ctrl-C in the calling thread all end at once.

    Parameters
    ----------
    work : callable
        From the number of a piece and a callback for its solvers to its result.
    count : int
        How many pieces there are.
    callback : callable, optional
        Called in the calling thread alone; with what other threads have for it when all have ended, piece
        after piece.
    ends : callable
        Whether no piece is wanted after one with this result.
    is_interrupted : callable
        Whether somebody pressed Ctrl-C in a piece with this result.

    Attributes
    ----------
    results : dict
        Of the pieces that are wanted, by number; after Ctrl-C of those that have been done.
    """

    def __init__(
        self,
        work: Callable[[int, Watch], T],
        count: int,
        callback: Callback | None = None,
        *,
        ends: Callable[[T], bool] = _never,
        is_interrupted: Callable[[T], bool] = _never,
    ) -> None:
        self.results: dict[int, T] = {}
        self._work, self._callback = work, callback
        self._ends, self._is_interrupted = ends, is_interrupted
        self._next, self._last = 0, count - 1
        self._watches: dict[int, Watch] = {}
        self._errors: dict[int, BaseException] = {}
        self._interrupt: KeyboardInterrupt | None = None
        self._is_given_up = False
        self._lock, self._all_taken = threading.Lock(), threading.Event()

    def run(self, threads: int, patience: float = 0.0) -> dict[int, T]:
        """The results, by so many threads in all, the calling one among them; others begin after a while [s].

        Raises
        ------
        BaseException
            What the earliest piece raises, or Ctrl-C. All threads have ended then.
        """
        count = min(threads, self._last + 1) - 1
        helpers = [threading.Thread(target=self._help, args=(patience,)) for _ in range(count)]
        begun: list[threading.Thread] = []
        first = self._hand_out(is_live=True)
        try:
            for helper in helpers:
                helper.start()
                begun.append(helper)
            if first is not None:
                self._do(*first)
            self._take(is_live=True)
            for helper in begun:
                helper.join()
        finally:
            self._end_all()  # nothing is left to end, but for Ctrl-C between two pieces
            for helper in begun:
                helper.join()
            self.results = {k: self.results[k] for k in sorted(self.results) if k <= self._last}
        if self._interrupt is not None:
            raise self._interrupt
        for number in sorted(self._watches):
            if number in self._errors and number <= self._last:
                raise self._errors[number]
            if number in self.results and not self._is_given_up:
                self._watches[number].show()
        return self.results

    def _help(self, patience: float) -> None:
        if not self._all_taken.wait(patience):
            self._take()

    def _take(self, *, is_live: bool = False) -> None:
        while (piece := self._hand_out(is_live=is_live)) is not None:
            self._do(*piece)

    def _hand_out(self, *, is_live: bool) -> tuple[int, Watch] | None:
        with self._lock:
            if self._next > self._last:
                self._all_taken.set()
                return None
            number, self._next = self._next, self._next + 1
            self._watches[number] = Watch(self._callback, is_live=is_live)
            return number, self._watches[number]

    def _do(self, number: int, watch: Watch) -> None:
        try:
            result = self._work(number, watch)
            if watch.is_ended:
                return
            self.results[number] = result
            if self._is_interrupted(result):
                self._is_given_up = True
                self._end_all()
            elif self._ends(result):
                self._end_after(number)
        except KeyboardInterrupt as error:
            if not watch.is_ended:
                self._interrupt = error
                self._end_all()
        except BaseException as error:
            self._errors[number] = error
            self._end_after(number)

    def _end_after(self, number: int) -> None:
        """Want no piece after this one."""
        with self._lock:
            self._last = min(self._last, number)
            for other, watch in self._watches.items():
                if other > self._last:
                    watch.end()

    def _end_all(self) -> None:
        """Begin no further piece, and end those under way."""
        with self._lock:
            self._next = max(self._next, self._last + 1)
            self._all_taken.set()
            for watch in self._watches.values():
                watch.end()
