"""An iterate as a start for another programme of the same unknowns."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING

import numpy as np

from mbocp._arrays import Array
from mbocp.programme.iterate import Iterate

if TYPE_CHECKING:
    from mbocp.programme.stagewise import StagewiseProgramme


@dataclass(frozen=True, eq=False)
class Carried:
    """An iterate, and what its numbers are.

    Attributes
    ----------
    iterate : Iterate
    names : tuple of str
        Of the columns of `iterate.bounds.path`.
    meaning : str
        Digest of what its unknowns and multipliers are, but for those of path constraints; "": nobody says.
    room : ndarray, shape (num_pairs,)
        Of each pair of things that keep apart what its row keeps beyond the margin [m]; -1: it has no row.
    limits_within : str
        Letters of the limits that hold within steps, too.
    q_end : ndarray, shape (nq,)
        Configuration at which conditions of the end were chosen; empty: that of the goal.
    q_start : ndarray, shape (nq,)
        Start that a solve of a robot that is found began with; empty: that of the problem.
    first : ndarray, shape (parameters,)
        Of what is found of the robot the values that a solve began with, and chose its conditions by.
    """

    iterate: Iterate
    names: tuple[str, ...]
    meaning: str = ""
    room: Array = field(default_factory=lambda: np.zeros(0))
    limits_within: str = ""
    q_end: Array = field(default_factory=lambda: np.zeros(0))
    q_start: Array = field(default_factory=lambda: np.zeros(0))
    first: Array = field(default_factory=lambda: np.zeros(0))

    @classmethod
    def of(cls, iterate: Iterate, programme: StagewiseProgramme) -> Carried:
        """An iterate of a programme."""
        return cls(iterate, () if iterate.bounds is None else programme.path_names)

    def rest(self, first: int) -> Carried:
        """What follows a node."""
        iterate, bounds = self.iterate, self.iterate.bounds
        if bounds is not None:
            rows = {name: getattr(bounds, name)[first:] for name in ("xs", "us", "path")}
            bounds = replace(bounds, **rows)
        rows = {name: getattr(iterate, name)[first:] for name in ("xs", "ys", "us", "ms")}
        return replace(self, iterate=replace(iterate, **rows, bounds=bounds))

    def fits(self, programme: StagewiseProgramme) -> bool:
        """Whether a programme has unknowns and multipliers of the same shapes, but for path constraints."""
        shapes = programme.shapes
        is_plain = all(getattr(self.iterate, name).shape == shape for name, shape in shapes.items())
        bounds = self.iterate.bounds
        if bounds is None or not is_plain:
            return is_plain
        at_steps = bounds.path.shape == (programme.num_steps, len(self.names))
        of_bounds = bounds.xs.shape == shapes["xs"] and bounds.us.shape == shapes["us"]
        return at_steps and of_bounds and bounds.guard.shape == (programme.num_guards,)

    def into(self, programme: StagewiseProgramme) -> Iterate:
        """The same for a programme with other path constraints.

        Rows that both have, by their names, keep their multipliers; new ones begin without, and so do rows
        that share a name, unless all names are the same.
        """
        iterate, wanted = self.iterate, programme.path_names
        if iterate.bounds is None or wanted == self.names:
            return iterate
        known = _places(self.names)
        path = np.zeros((programme.num_steps, programme.bounds.nh))
        for name, place in _places(wanted).items():
            if name in known:
                path[:, place] = iterate.bounds.path[:, known[name]]
        return replace(iterate, bounds=replace(iterate.bounds, path=path))


def _places(names: tuple[str, ...]) -> dict[str, int]:
    """Column of each name that there is once."""
    found, several = {}, set()
    for place, name in enumerate(names):
        if name in found:
            several.add(name)
        found[name] = place
    return {name: place for name, place in found.items() if name not in several}
