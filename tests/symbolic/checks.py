"""Comparisons of a model's functions with numeric Pinocchio, shared by the tests."""

from __future__ import annotations

import casadi as ca
import numpy as np
import pinocchio as pin

from mbocp.symbolic import ModelFunctions

REFERENCES = {
    "local": pin.ReferenceFrame.LOCAL,
    "world": pin.ReferenceFrame.WORLD,
    "local_world_aligned": pin.ReferenceFrame.LOCAL_WORLD_ALIGNED,
}


def assert_same(got: ca.DM, expected: np.ndarray, name: str, tolerance: float = 1e-9) -> None:
    expected = np.asarray(expected, dtype=float)
    got = np.asarray(got).reshape(expected.shape)
    scale = max(1.0, np.abs(expected).max(initial=0.0))
    assert np.abs(got - expected).max(initial=0.0) <= tolerance * scale, name


def symmetric(upper: np.ndarray) -> np.ndarray:
    return np.triu(upper) + np.triu(upper, 1).T


def check_dynamics(model, functions: ModelFunctions, q, v, a):
    data = model.createData()
    assert_same(functions.rnea(q, v, a), pin.rnea(model, data, q, v, a), "rnea")
    assert_same(
        functions.nonlinear_effects(q, v), pin.nonLinearEffects(model, data, q, v), "nonlinear_effects"
    )
    assert_same(functions.gravity(q), pin.computeGeneralizedGravity(model, data, q), "gravity")
    M = symmetric(pin.crba(model, data, q))
    assert_same(functions.crba(q), M, "crba")
    # Numeric Pinocchio 4.1.0 leaves the armature of unaligned revolute and helical joints out of its own.
    assert_same(functions.kinetic_energy(q, v), 0.5 * v @ M @ v, "kinetic_energy")
    assert_same(functions.potential_energy(q), pin.computePotentialEnergy(model, data, q), "potential_energy")
    assert_same(functions.center_of_mass(q), pin.centerOfMass(model, data, q), "center_of_mass")
    h = pin.computeCentroidalMomentum(model, data, q, v).vector
    assert_same(functions.centroidal_momentum(q, v), h, "centroidal_momentum")


def check_forward_dynamics(model, functions: ModelFunctions, q, v, a, singular: bool):
    data = model.createData()
    tau = pin.rnea(model, data, q, v, a)
    acceleration = pin.aba(model, data, q, v, tau)
    assert singular != np.isfinite(acceleration).all()
    if singular:
        return
    # Two orders of the same operations differ by round-off times the condition (icub: 2e8).
    condition = np.linalg.cond(symmetric(pin.crba(model, data, q)))
    tolerance = max(1e-9, 10 * np.finfo(float).eps * condition)
    assert_same(functions.aba(q, v, tau), acceleration, "aba", tolerance)
    assert_same(functions.minverse(q), symmetric(pin.computeMinverse(model, data, q)), "minverse", tolerance)


def check_manifold(model, functions: ModelFunctions, q, v):
    q1 = pin.integrate(model, q, v)
    assert_same(functions.integrate(q, v), q1, "integrate")
    assert_same(functions.difference(q, q1), pin.difference(model, q, q1), "difference")
    for got, expected in zip(functions.dintegrate(q, v), pin.dIntegrate(model, q, v), strict=True):
        assert_same(got, expected, "dintegrate")


def check_frames(model, functions: ModelFunctions, q, v):
    data = model.createData()
    pin.forwardKinematics(model, data, q, v)
    pin.updateFramePlacements(model, data)
    frame = model.nframes - 1
    R, p = functions.frame_placement(frame)(q)
    assert_same(R, data.oMf[frame].rotation, "frame_placement")
    assert_same(p, data.oMf[frame].translation, "frame_placement")
    for name, reference in REFERENCES.items():
        J = pin.computeFrameJacobian(model, model.createData(), q, frame, reference)
        assert_same(functions.frame_jacobian(frame, name)(q), J, f"frame_jacobian, {name}")
        twist = pin.getFrameVelocity(model, data, frame, reference).vector
        assert_same(functions.frame_velocity(frame, name)(q, v), twist, f"frame_velocity, {name}")


def check_constraints(model, functions: ModelFunctions, q):
    data = model.createData()
    pin.computeJointJacobians(model, data, q)
    last, middle = model.njoints - 1, model.njoints // 2
    placements = [pin.SE3(pin.rpy.rpyToMatrix(0.3, -0.2, k), np.array([0.1, k, 0.2])) for k in (0.5, 1.5)]
    local, aligned = pin.ReferenceFrame.LOCAL, pin.ReferenceFrame.LOCAL_WORLD_ALIGNED
    constraints = [
        pin.RigidConstraintModel(
            pin.ContactType.CONTACT_6D, model, last, placements[0], middle, placements[1], local
        ),
        pin.RigidConstraintModel(
            pin.ContactType.CONTACT_3D, model, last, placements[0], middle, placements[1], aligned
        ),
        pin.RigidConstraintModel(pin.ContactType.CONTACT_3D, model, last, placements[1], local),
    ]
    expected = []
    for constraint in constraints:
        constraint_data = constraint.createData()
        constraint.calc(model, data, constraint_data)
        expected.append(pin.getConstraintJacobian(model, data, constraint, constraint_data))
    assert_same(functions.constraint_jacobian(constraints)(q), np.vstack(expected), "constraint_jacobian")
