"""What a summary says of obstacles and of links that keep away from each other."""

from __future__ import annotations

import math
from collections import Counter
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from mbocp.problem.obstacles.clearance import Clearance

_TOLD = 20  # obstacles of which the summary speaks each
_TOLD_EXCESS = 1e-3  # of a file's volume


def clearance_lines(clearance: Clearance | None) -> tuple[str, ...]:
    """Say what is kept apart and what is left out, a line for each."""
    if clearance is None:
        return ()
    obstacles, owners = clearance.obstacles, clearance.owners
    lines, counts = [], Counter(k for _, k in {(a, owners[k]) for a, k in clearance.pairs})
    for k, obstacle in enumerate(obstacles[:_TOLD]):
        count = counts[k]
        told = [f"{n} {reason}" for reason, n in clearance.left_out.get(obstacle.name, {}).items()]
        left = f"; left out {' and '.join(told)}" if told else ""
        spheres = f"{count} {'sphere' if count == 1 else 'spheres'}"
        lines.append(f"{obstacle.name}: {spheres}{left}{_words_of_body(clearance, k)}")
    more = len(obstacles) - _TOLD
    if more > 0:
        count = sum(counts[k] for k in range(_TOLD, len(obstacles)))
        lines.append(f"and {more} more obstacles: {count} spheres")
    if clearance.self_pairs is not None:
        found = clearance.self_pairs
        told = [f"{len(pairs)} {reason}" for reason, pairs in found.left_out.items()]
        left = f"; left out {', '.join(told)}" if told else ""
        pairs = len(clearance.sphere_pairs)
        lines.append(f"itself: {len(found.links)} pairs of links, {pairs} of spheres{left}")
    used = sorted({link for link, _ in clearance.spheres})
    return (*lines, *filter(None, (clearance.robot.collision_spheres[link].words for link in used)))


def _words_of_body(clearance: Clearance, number: int) -> str:
    """How planes stand for hulls, and hulls or parts for the file of an obstacle."""
    obstacle = clearance.obstacles[number]
    planes = [p for k, p in clearance.planes.items() if clearance.owners[k] == number]
    kept = f"keep {1e3 * max((p.error for p in planes), default=0.0):.2g} mm more away at most"
    if obstacle.compound is not None:
        return f"; {obstacle.compound.words}" + (f"; planes around them {kept}" if planes else "")
    if not planes:
        return ""
    told = f"; {len(planes[0].offsets)} planes stand for its hull and {kept}"
    if math.isnan(obstacle.excess):
        return f"{told}; the surface in its file is not closed"
    more = f"; it has {100 * obstacle.excess:.3g} % more volume than its file"
    return told + (more if obstacle.excess > _TOLD_EXCESS else "")
