r"""How fast mass matrix and gravity change with the angles of joints at most, from lengths of links alone.

Boxes of rotation matrices grow from link to link, norms do not. A point that is no farther than :math:`\rho`
from the axis of a joint moves by :math:`\rho` for each radian, and a vector that turns with it changes by its
length, so that derivatives of the inertias of a chain are bounded by masses and lengths.
"""

from __future__ import annotations

import numpy as np
import pinocchio as pin

from mbocp._arrays import Array, dataclass
from mbocp.robot.joints import joint_kind


@dataclass(frozen=True, eq=False)
class Slopes:
    """Bounds of absolute values and derivatives, by velocity component.

    Attributes
    ----------
    M, gravity : ndarray, shape (n, n), (n,)
        Of the mass matrix, armatures left out, and of what gravity opposes the controls by.
    of_inertia, of_gravity : ndarray, shape (n, n, n), (n, n)
        Of their derivatives, in the coordinate of the last index.
    of_slopes : ndarray, shape (n, n, n)
        Of the second derivatives of gravity.
    """

    M: Array
    of_inertia: Array
    gravity: Array
    of_gravity: Array
    of_slopes: Array


def slopes_of(model: pin.Model, travel: Array) -> Slopes:
    """Bound them where sliding joints are no farther from zero than `travel`, shape (n,)."""
    n = model.nv
    found = Slopes(np.zeros((n, n)), np.zeros((n, n, n)), np.zeros(n), np.zeros((n, n)), np.zeros((n, n, n)))
    turns = np.array([joint_kind(model, j).word != "prismatic" for j in range(1, model.njoints)])
    at = [int(j.idx_v) for j in model.joints]
    field = float(np.linalg.norm(model.gravity.linear))
    for k in range(1, model.njoints):
        body, chain = model.inertias[k], [int(j) for j in model.supports[k] if j > 0]
        inertia = float(np.linalg.norm(body.inertia, 2))
        # Distances from axes to the centre of mass, and what a unit of each joint moves that by.
        reach: dict[int, float] = {}
        out = float(np.linalg.norm(body.lever))
        for j in reversed(chain):
            reach[j] = out + (0.0 if turns[j - 1] else float(travel[at[j]]))
            out = reach[j] + float(np.linalg.norm(model.jointPlacements[j].translation))
        moved = {j: reach[j] if turns[j - 1] else 1.0 for j in chain}
        for a, i in enumerate(chain):
            found.gravity[at[i]] += body.mass * field * moved[i]
            for b, other in enumerate(chain):
                rate = _change(turns, moved, i, other, is_above=b <= a)
                found.of_gravity[at[i], at[other]] += body.mass * field * rate
                for c, third in enumerate(chain):  # the last of the three has the shortest lever
                    lever = moved[chain[max(a, b, c)]]
                    found.of_slopes[at[i], at[other], at[third]] += body.mass * field * lever
            for b in range(a, len(chain)):
                j = chain[b]
                both = inertia * turns[i - 1] * turns[j - 1]
                found.M[at[i], at[j]] += body.mass * moved[i] * moved[j] + both
                # What turns both joints changes nothing: seen from the first, its axis does not move.
                for c in range(a + 1, len(chain)):
                    other = chain[c]
                    of_i = moved[other] * turns[i - 1]
                    of_j = _change(turns, moved, j, other, is_above=c <= b)
                    rate = body.mass * (of_i * moved[j] + moved[i] * of_j) + 3.0 * both * turns[other - 1]
                    found.of_inertia[at[i], at[j], at[other]] += rate
    for i in range(n):
        for j in range(i):  # entries of branches stand on one side only
            found.M[i, j] = found.M[j, i] = max(found.M[i, j], found.M[j, i])
            larger = np.maximum(found.of_inertia[i, j], found.of_inertia[j, i])
            found.of_inertia[i, j] = found.of_inertia[j, i] = larger
    return found


def _change(turns: Array, moved: dict[int, float], i: int, other: int, *, is_above: bool) -> float:
    """How much what joint i moves a centre of mass by changes with another joint."""
    if is_above:  # it turns as a whole
        return moved[i] if turns[other - 1] else 0.0
    return moved[other] if turns[i - 1] else 0.0
