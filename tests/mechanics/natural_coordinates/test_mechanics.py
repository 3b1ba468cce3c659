"""Natural coordinates against Pinocchio: accelerations, mass matrix, forces, maps to the joints and back."""

from __future__ import annotations

import dataclasses
import warnings

import casadi as ca
import numpy as np
import pinocchio as pin
import pytest
import scipy.sparse as sp
import scipy.sparse.linalg as spla

from mbocp.exceptions import UnsupportedRobot
from mbocp.mechanics import NaturalMechanics
from mbocp.mechanics.natural_coordinates.bodies import SIZE, body_tree
from mbocp.mechanics.natural_coordinates.space import NaturalSpace
from mbocp.robot import Robot, load_robot
from mbocp.robot.loading.readers import example_robots as examples

FEW = (
    "double_pendulum",
    "ur5",
    "panda",
    "kinova",
    "hector",
    "anymal",
    "rigid_pendulum",
    "cart_pendulum_elastic",
)
MANY = [name for name in examples.names() if name not in FEW]
LARGEST = 60  # links

JOINTS = """<robot name="zoo"><link name="base"/>
<link name="a"><inertial><origin xyz="0.1 0.2 -0.1" rpy="0.3 0.2 0.1"/><mass value="2"/>
<inertia ixx="0.3" ixy="0.01" ixz="0.02" iyy="0.25" iyz="-0.01" izz="0.2"/></inertial></link>
<link name="b"><inertial><origin xyz="0 0.1 0.3"/><mass value="1"/>
<inertia ixx="0.1" ixy="0" ixz="0" iyy="0.1" iyz="0.01" izz="0.08"/></inertial></link>
<link name="c"><inertial><origin xyz="0.1 0 0"/><mass value="1.5"/>
<inertia ixx="0.1" ixy="0" ixz="0" iyy="0.12" iyz="0" izz="0.08"/></inertial></link>
<link name="d"><inertial><origin xyz="0.1 0 0"/><mass value="0.5"/>
<inertia ixx="0.01" ixy="0" ixz="0" iyy="0.012" iyz="0" izz="0.008"/></inertial></link>
<link name="e"><inertial><mass value="0.4"/>
<inertia ixx="0.01" ixy="0" ixz="0" iyy="0.012" iyz="0" izz="0.008"/></inertial></link>
<link name="f"><inertial><mass value="0.3"/>
<inertia ixx="0.01" ixy="0" ixz="0" iyy="0.012" iyz="0" izz="0.008"/></inertial></link>
<joint name="rail" type="prismatic"><parent link="base"/><child link="a"/>
<origin xyz="0 0 1" rpy="0.2 0 0.4"/>
<axis xyz="1 1 0"/><limit lower="-3" upper="3" effort="10" velocity="10"/></joint>
<joint name="hinge" type="revolute"><parent link="a"/><child link="b"/>
<origin xyz="0 0.2 1" rpy="0.2 0 0.4"/>
<axis xyz="1 2 -1"/><limit lower="-3" upper="3" effort="10" velocity="10"/></joint>
<joint name="push" type="prismatic"><parent link="b"/><child link="c"/>
<origin xyz="0.1 0.2 0.3" rpy="0.2 -0.5 0"/>
<axis xyz="0 1 3"/><limit lower="-3" upper="3" effort="10" velocity="10"/></joint>
<joint name="table" type="planar"><parent link="c"/><child link="d"/>
<origin xyz="0.1 0.2 0.3" rpy="0.2 -0.5 0"/>
<axis xyz="0 0 1"/></joint>
<joint name="wheel" type="continuous"><parent link="d"/><child link="e"/>
<origin xyz="0.1 0.2 0.3" rpy="0 0.5 0"/>
<axis xyz="0 1 0"/><limit effort="10" velocity="10"/></joint>
<joint name="geared" type="revolute"><parent link="e"/><child link="f"/>
<origin xyz="0.1 0 0.3" rpy="0 0.5 0"/>
<axis xyz="0 0 1"/><mimic joint="hinge" multiplier="-0.7" offset="0.2"/>
<limit lower="-3" upper="3" effort="10" velocity="10"/></joint>
</robot>"""
ACTUATORS = """urdf = "zoo.urdf"
[[actuator]]
type = "joint"
joint = "hinge"
[[actuator]]
type = "joint"
joint = "push"
[[actuator]]
type = "joint"
joint = "table"
[[actuator]]
type = "joint"
joint = "rail"
[[actuator]]
type = "joint"
joint = "wheel"
[[actuator]]
type = "wrench"
frame = "e"
[[actuator]]
type = "thruster"
frame = "a"
axis = [1.0, 2.0, 0.0]
position = [0.1, 0.2, 0.3]
torque_ratio = 0.1
[[spring_damper]]
name = "strut"
frames = ["c", "base"]
stiffness = 7.0
damping = 0.4
length = 0.3
"""


def zoo(folder, spherical: str = "") -> Robot:
    (folder / "zoo.urdf").write_text(JOINTS)
    (folder / "robot.toml").write_text(spherical + ACTUATORS)
    return load_robot(folder / "robot.toml")


def loaded(name: str, folder) -> Robot:
    if name.startswith("zoo"):
        return zoo(folder)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # poses and meshes are not what is looked at
        try:
            return load_robot(name)
        except UnsupportedRobot as error:
            pytest.skip(f"no robot at all: {error}")


def state(robot: Robot, seed: int = 3) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    rng = np.random.default_rng(seed)
    model = robot.model
    q = pin.integrate(model, pin.neutral(model), rng.uniform(-1.0, 1.0, robot.nv))
    return q, rng.standard_normal(robot.nv), rng.standard_normal(robot.nu)


def kinematics(mechanics: NaturalMechanics, q: np.ndarray, v: np.ndarray, a: np.ndarray) -> np.ndarray:
    """Second time derivative of the natural coordinates, from Pinocchio's accelerations."""
    tree, model = mechanics.tree, mechanics.robot.model
    data = model.createData()
    pin.forwardKinematics(model, data, q, v, a)
    out = np.zeros(tree.n)
    out[: len(tree.sliding)] = a[list(tree.sliding)]
    for body in tree.turning:
        R = data.oMi[body.joint].rotation
        spin, rate = R @ data.v[body.joint].angular, R @ data.a[body.joint].angular
        origin = R @ (
            data.a[body.joint].linear + np.cross(data.v[body.joint].angular, data.v[body.joint].linear)
        )

        def turning(arm: np.ndarray, spin=spin, rate=rate) -> np.ndarray:
            return np.cross(rate, arm) + np.cross(spin, np.cross(spin, arm))

        arms = [R @ body.lever, *R.T]
        blocks = [turning(arm) for arm in arms]
        blocks[0] = blocks[0] + origin
        out[body.at : body.at + SIZE] = np.concatenate(blocks)
    return out


def equations(mechanics: NaturalMechanics) -> ca.Function:
    """(q, v, u) -> Phi, Phi_q, its rate times v, M, forces."""
    q, v = ca.SX.sym("q", mechanics.nq), ca.SX.sym("v", mechanics.nv)
    u = ca.SX.sym("u", mechanics.nu)
    phi = mechanics.constraints(q)
    jacobian = ca.jacobian(phi, q)
    force = mechanics.force(q, v, u) - mechanics.inverse_dynamics(q, v, ca.SX.zeros(mechanics.nv))
    outputs = [phi, jacobian, ca.jtimes(jacobian @ v, q, v), mechanics.mass_matrix(q), force]
    return ca.Function("equations", [q, v, u], outputs)


def solved(mass: ca.DM, jacobian: ca.DM, force: np.ndarray, rate: np.ndarray) -> np.ndarray:
    """Accelerations of the index-1 system, with the residual of the linear solve checked."""
    G, M = jacobian.sparse(), mass.sparse()
    kkt = sp.bmat([[M, G.T], [G, None]], format="csc")
    right = np.concatenate([force, -rate])
    factor = spla.splu(kkt)
    found = factor.solve(right)
    found += factor.solve(right - kkt @ found)
    assert np.abs(kkt @ found - right).max() <= 1e-8 * (1.0 + np.abs(right).max())
    return found[: len(force)]


def check_accelerations(robot: Robot) -> None:
    mechanics = NaturalMechanics(robot)
    q, v, u = state(robot)
    z, w = mechanics.tree.coordinates(q[None])[0], mechanics.tree.jacobian(q) @ v
    phi, jacobian, rate, mass, force = equations(mechanics)(z, w, u)
    assert np.abs(np.asarray(phi)).max(initial=0.0) < 1e-12 * (1.0 + np.abs(z).max())
    G = np.asarray(jacobian)
    assert np.abs(G @ w).max(initial=0.0) < 1e-11 * (1.0 + np.abs(w).max())
    assert mechanics.nc == mechanics.nv - robot.nv + robot.nc
    assert mechanics.nc == 0 or np.linalg.svd(G, compute_uv=False)[-1] > 1e-3  # full rank
    found = solved(mass, jacobian, np.asarray(force).ravel(), np.asarray(rate).ravel())
    tau = robot.actuation_matrix(q) @ u + robot.force_elements(q, v)
    a = acceleration(robot, q, v, tau)
    expected = kinematics(mechanics, q, v, a)
    assert np.abs(found - expected).max() <= 1e-10 * max(1.0, np.abs(expected).max())


def acceleration(robot: Robot, q: np.ndarray, v: np.ndarray, tau: np.ndarray) -> np.ndarray:
    """Pinocchio's forward dynamics; it has none for models with mimic joints."""
    if any(name == "JointModelMimic" for name in (j.shortname() for j in robot.model.joints)):
        bias = pin.rnea(robot.model, robot.model.createData(), q, v, np.zeros(robot.nv))
        return np.linalg.solve(robot.mass_matrix(q), tau - bias)
    return pin.aba(robot.model, robot.model.createData(), q, v, tau)


@pytest.mark.parametrize("name", [n for n in FEW if n != "rigid_pendulum"] + ["zoo"])
def test_accelerations(name: str, tmp_path) -> None:
    check_accelerations(loaded(name, tmp_path))


@pytest.mark.slow
@pytest.mark.parametrize("name", MANY)
def test_accelerations_of_many(name: str, tmp_path) -> None:
    robot = loaded(name, tmp_path)
    if robot.model.njoints - 1 > LARGEST:
        pytest.skip(f"{robot.model.njoints - 1} links")
    check_accelerations(robot)


@pytest.mark.parametrize("name", [*FEW, "zoo"])
def test_there_and_back(name: str, tmp_path) -> None:
    robot = loaded(name, tmp_path)
    mechanics = NaturalMechanics(robot)
    q, v, _ = state(robot)
    space = NaturalSpace(mechanics, q)
    z, w = space.coordinates(q[None]), space.rates(q[None], v[None])
    assert np.allclose(robot.difference(q, space.configurations(z)[0]), 0.0, atol=1e-12)
    assert np.allclose(space.velocities(z, w)[0], v, atol=1e-12)


@pytest.mark.parametrize("name", ["ur5", "anymal", "zoo"])
def test_centre_of_mass_and_momentum_about_it(name: str, tmp_path) -> None:
    robot = loaded(name, tmp_path)
    mechanics, data = NaturalMechanics(robot), robot.model.createData()
    q, v, _ = state(robot)
    z, w = mechanics.tree.coordinates(q[None])[0], mechanics.tree.jacobian(q) @ v
    at, rate = ca.SX.sym("q", mechanics.nq), ca.SX.sym("v", mechanics.nv)
    outputs = [mechanics.centre_of_mass(at), mechanics.centroidal_momentum(at, rate)]
    centre, momentum = ca.Function("f", [at, rate], outputs)(z, w)
    wanted = pin.computeCentroidalMomentum(robot.model, data, q, v).vector
    assert np.allclose(np.asarray(centre).ravel(), data.com[0], atol=1e-12)
    assert np.allclose(np.asarray(momentum).ravel(), wanted, atol=1e-11 * (1.0 + np.abs(wanted).max()))


@pytest.mark.parametrize("name", ["ur5", "anymal", "zoo"])
def test_mass_matrix_and_potential(name: str, tmp_path) -> None:
    robot = loaded(name, tmp_path)
    mechanics = NaturalMechanics(robot)
    q, _, _ = state(robot)
    z, J = mechanics.tree.coordinates(q[None])[0], mechanics.tree.jacobian(q)
    at = ca.SX.sym("q", mechanics.nq)
    function = ca.Function(
        "f", [at], [mechanics.mass_matrix(at), mechanics.potential_energy(at), mechanics.joint_motions(at)]
    )
    mass, energy, motions = (np.asarray(value) for value in function(z))
    assert np.allclose(J.T @ mass @ J, robot.mass_matrix(q), rtol=0.0, atol=1e-13 * np.abs(mass).max() * 10)
    assert np.isclose(float(energy[0, 0]), robot.potential_energy(q), rtol=1e-12)
    assert np.allclose(motions, J, atol=1e-13)


@pytest.mark.parametrize("name", ["ur5", "anymal", "zoo"])
def test_jacobian_is_the_derivative_along_a_motion(name: str, tmp_path) -> None:
    robot = loaded(name, tmp_path)
    tree = body_tree(robot)
    q, v, _ = state(robot)
    h = 1e-3
    ahead = [tree.coordinates(robot.integrate(q, k * h * v)[None])[0] for k in (-2, -1, 1, 2)]
    numeric = (ahead[0] - 8 * ahead[1] + 8 * ahead[2] - ahead[3]) / (12 * h)  # of fourth order
    assert np.allclose(tree.jacobian(q) @ v, numeric, atol=1e-8)


def test_constraints_have_full_rank_where_the_joints_tie_everything(tmp_path) -> None:
    robot = loaded("zoo", tmp_path)
    mechanics = NaturalMechanics(robot)
    q, _, u = state(robot)
    jacobian = np.asarray(
        equations(mechanics)(mechanics.tree.coordinates(q[None])[0], np.zeros(mechanics.nv), u)[1]
    )
    assert np.linalg.matrix_rank(jacobian) == mechanics.nc == mechanics.nv - robot.nv
    assert len(mechanics.constraint_labels) == mechanics.nc


def test_sliding_masses_keep_their_coordinates() -> None:
    mechanics = NaturalMechanics(load_robot("rigid_pendulum"))
    assert (mechanics.nq, mechanics.nc) == (3, 1)


def test_groups_cover_the_tree(tmp_path) -> None:
    mechanics = NaturalMechanics(loaded("anymal", tmp_path))
    rows = [i for first, count, _ in mechanics.groups for i in range(first, first + count)]
    assert rows == list(range(mechanics.nc))


def test_what_natural_coordinates_cannot_describe_is_refused_by_name() -> None:
    with pytest.raises(UnsupportedRobot, match="natural coordinates"):
        NaturalMechanics(load_robot("unicycle_pendulum"))


def test_rotors_that_turn_with_a_joint() -> None:
    arm = load_robot("ur5")
    model = arm.model.copy()
    model.armature = np.array([0.0, 0.1, 0.0, 0.3, 0.0, 0.02])
    check_accelerations(dataclasses.replace(arm, model=model))
