r"""Robots of many joints: Pinocchio's working memory, and algorithms without it.

Pinocchio's `Data` holds four arrays of nv^3 numbers for second derivatives, whether they are asked for or
not: 32 MB for a hundred joints, 4 GB for five hundred. Its algorithms need it all the same. So a `Data` is
made here only, after a look at the memory there is, and the mass matrix of a large robot, which is all that
loading one takes, is computed without it.
"""

from __future__ import annotations

import numpy as np
import pinocchio as pin

from mbocp._arrays import Array
from mbocp._memory import check_memory

_MIN_LARGE_NV = 100  # velocities, from which on Pinocchio's working memory is avoided
_TENSORS = 4  # of nv^3 numbers


def is_large(model: pin.Model) -> bool:
    """Whether Pinocchio's working memory counts."""
    return int(model.nv) > _MIN_LARGE_NV


def make_working_data(model: pin.Model) -> pin.Data:
    """Pinocchio's working memory for a model; raises as `check_working_memory` does."""
    check_working_memory(model)
    return pin.Data(model)  # model.createData() would make it twice, and copy


def check_working_memory(model: pin.Model) -> None:
    """Refuse a model for whose working memory there is no room, before Pinocchio makes it.

    Raises
    ------
    MemoryLimitExceeded
        If there is not enough memory for it.
    """
    if is_large(model):
        check_memory(
            8.0 * _TENSORS * model.nv**3,
            f"robot {model.name!r}: Pinocchio's working memory for its {model.nv} velocities",
            "Take fewer links",
        )


def composite_mass_matrix(model: pin.Model, q: Array) -> Array:
    r"""Joint-space mass matrix by composite rigid bodies in world axes, without a `pin.Data`.

    .. math:: M_{ij} = J_i^T \bar Y_j J_j \quad \text{for joints i on the way from the root to j}

    with the columns J of the joints' motions and the inertia :math:`\bar Y_j` of all that joint j carries.

    Parameters
    ----------
    model : pin.Model
        Without mimic joints.
    q : ndarray, shape (nq,)

    Returns
    -------
    mass : ndarray, shape (nv, nv)
        Symmetric, armature included.
    """
    placements, motions = [pin.SE3.Identity()], np.zeros((6, model.nv))
    inertias = np.zeros((model.njoints, 6, 6))
    for j in range(1, model.njoints):
        joint = model.joints[j]
        data = joint.createData()
        joint.calc(data, q)
        placement = placements[model.parents[j]] * model.jointPlacements[j] * data.M
        placements.append(placement)
        columns = np.asarray(data.S).reshape(6, joint.nv)
        motions[:, joint.idx_v : joint.idx_v + joint.nv] = placement.toActionMatrix() @ columns
        inertias[j] = placement.act(model.inertias[j]).matrix()
    for j in range(model.njoints - 1, 0, -1):
        inertias[model.parents[j]] += inertias[j]
    mass = np.diag(np.asarray(model.armature, dtype=np.float64))
    ways = [np.zeros(0, dtype=np.intp)]  # velocities from the root to each joint
    for j in range(1, model.njoints):
        own = np.arange(model.joints[j].idx_v, model.joints[j].idx_v + model.joints[j].nv)
        before = ways[model.parents[j]]
        ways.append(np.concatenate([before, own]))
        forces = inertias[j] @ motions[:, own]
        mass[np.ix_(own, own)] += motions[:, own].T @ forces
        mass[np.ix_(before, own)] = motions[:, before].T @ forces
    upper = np.triu(mass)
    return upper + np.triu(upper, 1).T
