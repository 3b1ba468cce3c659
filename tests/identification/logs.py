"""Robots with other numbers than their files, and logs of them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pinocchio as pin

from mbocp._arrays import Array
from mbocp.identification import Identification, Log
from mbocp.identification.consistent import _thick, body_of, log_cholesky
from mbocp.identification.dynamics import InverseDynamics, JointMotion
from mbocp.identification.unknown_parameters import pseudo_inertia
from mbocp.robot import JointResistance, Robot


def changed(robot: Robot, seed: int = 5, share: float = 0.2, speed: float = 0.1) -> Robot:
    """The robot with other inertias, and friction in its motors."""
    rng, model = np.random.default_rng(seed), pin.Model(robot.model)
    for joint in range(1, model.njoints):
        if model.inertias[joint].mass > 0.0:
            theta = log_cholesky(_thick(pseudo_inertia(model.inertias[joint].toDynamicParameters())))
            length = max(np.exp(theta[1:4]).max(), np.abs(theta[7:]).max())
            theta += share * rng.standard_normal(10) * np.array([1.0] * 4 + [0.3 * length] * 6)
            model.inertias[joint] = pin.Inertia.FromDynamicParameters(body_of(theta))
    names = [label.name for label in robot.u_labels]
    losses = (JointResistance(n, robot.velocity_indices(n).start, 1.0, 0.3, 0.5, speed) for n in names)
    return replace(robot, model=model, resistances=tuple(losses))


def log_of(dynamics: InverseDynamics, motion: JointMotion, t: Array, seed: int, noise: float = 0.05) -> Log:
    """What is measured along a motion, with noise of 1e-4 rad in positions."""
    rng, still = np.random.default_rng(seed), np.zeros((len(t), dynamics.robot.nu))
    torques = dynamics.regressor(motion) @ dynamics.values - dynamics.compute_applied_torques(motion, still)
    y = np.array([dynamics.coordinates(q) for q in motion.qs])
    u = torques + noise * rng.standard_normal(torques.shape)
    y = y + 1e-4 * rng.standard_normal(y.shape)
    return Log(t, {name: {"q": y[:, j], "tau": u[:, j]} for j, name in enumerate(dynamics.names)})


def true_values(found: Identification, robot: Robot) -> Array:
    """Parameters of a robot, as the result has them."""
    bodies = [inertia.toDynamicParameters() for inertia in list(robot.model.inertias)[1:]]
    losses = np.zeros((2, robot.nv))
    for loss in robot.resistances:
        losses[:, loss.dof] = loss.damping, loss.friction
    everything = np.concatenate([*bodies, np.asarray(robot.model.armature), *losses])
    known = everything - found.unknowns.known
    return np.asarray(np.linalg.lstsq(found.unknowns.shares, known, rcond=None)[0])
