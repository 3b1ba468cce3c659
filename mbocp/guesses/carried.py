"""An iterate as a start for a problem that differs in its inequalities alone."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from mbocp.programme import Iterate, StagewiseProgramme

__all__ = ["Carried"]


@dataclass(frozen=True, eq=False)
class Carried:
    """An iterate, and what the rows of its path constraints are called.

    Attributes
    ----------
    iterate : Iterate
    names : tuple of str
        Of the columns of `iterate.bounds.path`.
    """

    iterate: Iterate
    names: tuple[str, ...]

    @classmethod
    def of(cls, iterate: Iterate, programme: StagewiseProgramme) -> Carried:
        """An iterate of a programme."""
        return cls(iterate, programme.path_names)

    def into(self, programme: StagewiseProgramme) -> Iterate:
        """The same for a programme with other path constraints.

        Rows that both have, by their names, keep their multipliers; new ones begin without, and so do rows
        that share a name.
        """
        iterate, wanted = self.iterate, programme.path_names
        if iterate.bounds is None:
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
