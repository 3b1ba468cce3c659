"""Configurations of a robot along a motion as it is sent."""

from __future__ import annotations

import numpy as np

from mbocp._arrays import Array, BoolArray
from mbocp.solution.sent import Sent


def is_sent(sent: Sent) -> tuple[BoolArray, BoolArray]:
    """Which coordinates of q and v are those of joints that are sent, shapes (nq,) and (nv,).

    Those of floating bases and of balls are not.
    """
    labels, names = sent.solution.labels, set(sent.joints)
    of_q = [bool({column.name, column.name.rpartition(".")[0]} & names) for column in labels.q]
    return np.array(of_q), np.array([column.name in names for column in labels.v])


def states_of(sent: Sent, positions: Array, rates: Array, others: Array | None = None) -> tuple[Array, Array]:
    """Configurations, shape (n, nq), and rates in the order of v, of joints that are sent, shape (n, joints).

    Other coordinates are those of `others`, shape (n, nq), or of the solution's start; their rates are zero.
    """
    solution, places = sent.solution, {name: k for k, name in enumerate(sent.joints)}
    of_q, of_v = is_sent(sent)
    qs = np.repeat(solution.qs[:1], len(positions), axis=0) if others is None else others.copy()
    for k in np.flatnonzero(of_q):
        name = solution.labels.q[k].name
        joint, _, function = name.rpartition(".")
        if name in places:
            qs[:, k] = positions[:, places[name]]
        else:  # cosine or sine of one that turns without end
            qs[:, k] = getattr(np, function)(positions[:, places[joint]])
    vs = np.zeros((len(positions), len(of_v)))
    vs[:, of_v] = rates[:, [places[column.name] for column in solution.labels.v if column.name in places]]
    return qs, vs
