"""Every kind of joint, alone and mimicking, against numeric Pinocchio."""

from __future__ import annotations

import numpy as np
import pinocchio as pin
import pytest

from mbocp.symbolic import model_functions
from tests.symbolic.checks import (
    assert_same,
    check_constraints,
    check_dynamics,
    check_forward_dynamics,
    check_frames,
    check_manifold,
    symmetric,
)

AXIS = np.array([1.0, 2.0, -2.0]) / 3.0


def continuous_unaligned() -> pin.JointModel:
    """Only the URDF parser can give this joint its axis."""
    text = """<robot name="r"><link name="a"/><link name="b"/><joint name="j" type="continuous">
      <parent link="a"/><child link="b"/><axis xyz="0.6 0 0.8"/></joint></robot>"""
    return pin.buildModelFromXML(text).joints[1]


def composite() -> pin.JointModelComposite:
    joint = pin.JointModelComposite(pin.JointModelRX(), pin.SE3(np.eye(3), np.array([0.1, 0.0, 0.2])))
    joint.addJoint(pin.JointModelSpherical(), pin.SE3(np.eye(3), np.array([0.0, 0.3, 0.0])))
    return joint


JOINTS = {
    "revolute x": pin.JointModelRX(),
    "revolute y": pin.JointModelRY(),
    "revolute z": pin.JointModelRZ(),
    "revolute unaligned": pin.JointModelRevoluteUnaligned(AXIS),
    "continuous x": pin.JointModelRUBX(),
    "continuous y": pin.JointModelRUBY(),
    "continuous z": pin.JointModelRUBZ(),
    "continuous unaligned": continuous_unaligned(),
    "prismatic x": pin.JointModelPX(),
    "prismatic y": pin.JointModelPY(),
    "prismatic z": pin.JointModelPZ(),
    "prismatic unaligned": pin.JointModelPrismaticUnaligned(AXIS),
    "spherical": pin.JointModelSpherical(),
    "spherical ZYX": pin.JointModelSphericalZYX(),
    "ellipsoid": pin.JointModelEllipsoid(0.1, 0.2, 0.3),
    "translation": pin.JointModelTranslation(),
    "planar": pin.JointModelPlanar(),
    "free-flyer": pin.JointModelFreeFlyer(),
    "universal": pin.JointModelUniversal(np.array([1.0, 0.0, 0.0]), np.array([0.0, 1.0, 0.0])),
    "helical x": pin.JointModelHX(0.1),
    "helical y": pin.JointModelHY(0.1),
    "helical z": pin.JointModelHZ(0.1),
    "helical unaligned": pin.JointModelHelicalUnaligned(AXIS, 0.1),
    "composite": composite(),
}


def tree_with(joint) -> pin.Model:
    """The joint between two others, and beside a third."""
    rng = np.random.default_rng(3)
    model = pin.Model()
    model.name = joint.shortname()
    parent = 0
    for k, member in enumerate((pin.JointModelRX(), joint, pin.JointModelRevoluteUnaligned(AXIS))):
        placement = pin.SE3(pin.rpy.rpyToMatrix(*rng.uniform(-1.0, 1.0, 3)), rng.uniform(-0.5, 0.5, 3))
        parent = model.addJoint(parent, member, placement, f"joint {k}")
        model.appendBodyToJoint(parent, pin.Inertia.Random(), pin.SE3.Identity())
        model.addBodyFrame(f"body {k}", parent, placement.inverse(), 0)
    beside = model.addJoint(1, pin.JointModelRZ(), pin.SE3.Identity(), "beside")
    model.appendBodyToJoint(beside, pin.Inertia.Random(), pin.SE3.Identity())
    model.armature = rng.uniform(0.0, 0.2, model.nv)
    return model


@pytest.mark.parametrize("name", JOINTS)
def test_joint_agrees_with_numeric_pinocchio(name, random_state):
    pin.seed(0)
    model = tree_with(JOINTS[name])
    functions = model_functions(model)
    q, v, a = random_state(model)
    check_dynamics(model, functions, q, v, a)
    check_forward_dynamics(model, functions, q, v, a, singular=False)
    check_manifold(model, functions, q, v)
    check_frames(model, functions, q, v)
    check_constraints(model, functions, q)


def link(name: str, mass: float) -> str:
    return f"""<link name="{name}"><inertial><origin xyz="0.1 0.05 0.2"/><mass value="{mass}"/>
      <inertia ixx="0.02" iyy="0.03" izz="0.04" ixy="0.001" ixz="0.002" iyz="0.003"/></inertial></link>"""


def joint(name: str, kind: str, parent: str, child: str, mimic: str = "") -> str:
    return f"""<joint name="{name}" type="{kind}"><parent link="{parent}"/><child link="{child}"/>
      <origin xyz="0.1 0.2 0.3" rpy="0.2 0.1 0.4"/><axis xyz="0 0.6 0.8"/>
      <limit lower="-3" upper="3" effort="10" velocity="10"/>{mimic}</joint>"""


def mimicking_model() -> pin.Model:
    """A free-flying hand: revolute, prismatic and continuous joints, each with one that mimics it."""
    parts = [link("palm", 2.0)]
    for kind, multiplier, offset in (
        ("revolute", -0.7, 0.3),
        ("prismatic", 1.5, 0.1),
        ("continuous", 1.0, 0.4),
    ):
        mimic = f'<mimic joint="{kind}" multiplier="{multiplier}" offset="{offset}"/>'
        parts += [link(f"{kind} near", 0.5), link(f"{kind} far", 0.3)]
        parts.append(joint(kind, kind, "palm", f"{kind} near"))
        parts.append(joint(f"{kind} follower", kind, f"{kind} near", f"{kind} far", mimic))
    parts.append(link("tip", 0.2) + joint("wrist", "revolute", "revolute far", "tip"))
    text = f'<robot name="hand">{"".join(parts)}</robot>'
    model = pin.buildModelFromXML(text, pin.JointModelFreeFlyer(), True)
    model.armature = np.linspace(0.0, 0.3, model.nv)
    return model


def test_mimic_joints_agree_with_numeric_pinocchio(random_state):
    model = mimicking_model()
    assert len(model.mimicking_joints) == 3
    functions, data = model_functions(model), model.createData()
    q, v, a = random_state(model)
    assert_same(functions.rnea(q, v, a), pin.rnea(model, data, q, v, a), "rnea")
    assert_same(functions.crba(q), symmetric(pin.crba(model, data, q)), "crba")
    check_manifold(model, functions, q, v)
    pin.forwardKinematics(model, data, q, v)
    pin.updateFramePlacements(model, data)
    for frame in range(model.nframes):
        R, p = functions.frame_placement(frame)(q)
        assert_same(R, data.oMf[frame].rotation, "frame_placement")
        assert_same(p, data.oMf[frame].translation, "frame_placement")
        twist = pin.getFrameVelocity(model, data, frame, pin.ReferenceFrame.LOCAL).vector
        assert_same(functions.frame_velocity(frame)(q, v), twist, "frame_velocity")
        assert_same(functions.frame_jacobian(frame)(q) @ v, twist, "frame_jacobian")


def test_mimic_joints_in_functions_that_upstream_does_not_offer(random_state):
    model = mimicking_model()
    functions = model_functions(model)
    q, v, a = random_state(model)
    zero = np.zeros(model.nv)
    tau, M = functions.rnea(q, v, a), np.array(functions.crba(q))
    assert_same(functions.aba(q, v, tau), a, "aba inverts rnea")
    assert_same(functions.minverse(q) @ M, np.eye(model.nv), "minverse inverts crba")
    assert_same(
        functions.nonlinear_effects(q, v), np.array(functions.rnea(q, v, zero)).ravel(), "rnea at rest"
    )
    assert_same(functions.gravity(q), np.array(functions.rnea(q, zero, zero)).ravel(), "gravity")
    assert_same(functions.kinetic_energy(q, v), 0.5 * v @ M @ v, "kinetic energy")
    linear = sum(inertia.mass for inertia in model.inertias) * center_of_mass_velocity(functions, q, v)
    assert_same(np.array(functions.centroidal_momentum(q, v))[:3], linear, "linear momentum")
    step = 1e-6
    power = (potential(functions, q, step * v) - potential(functions, q, -step * v)) / (2 * step)
    assert power == pytest.approx(float(np.array(functions.gravity(q)).ravel() @ v), rel=1e-7)


def potential(functions, q, dv) -> float:
    return float(functions.potential_energy(functions.integrate(q, dv)))


def center_of_mass_velocity(functions, q, v) -> np.ndarray:
    """Central difference along the motion, fourth order [m/s]."""
    step = 1e-3
    c = [np.array(functions.center_of_mass(functions.integrate(q, k * step * v))) for k in (-2, -1, 1, 2)]
    return (c[0] - 8 * c[1] + 8 * c[2] - c[3]) / (12 * step)
