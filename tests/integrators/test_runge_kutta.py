"""Explicit Runge-Kutta methods: conditions on their coefficients, orders on Lie groups, and what is kept."""

from __future__ import annotations

import math
from collections.abc import Iterator
from fractions import Fraction
from itertools import combinations_with_replacement

import casadi as ca
import numpy as np
import pinocchio as pin
import pytest

from mbocp._arrays import Array
from mbocp.integrators import LIE_METHODS, TABLEAUX, Tableau
from mbocp.lie import ConfigurationSpace
from mbocp.lie.groups import Circle, Plane, Quaternion
from mbocp.robot import Robot
from tests.integrators.explicit import GAMMAS, Simulation, mechanics_of, reference, robot_named, start_of

ORDER = {"euler": 1, "heun": 2, "rk4": 4, "rkf5": 5}
ROTATIONS = ("quaternion", "dcm")
DURATION = 0.5  # [s]

# --- coefficients -----------------------------------------------------------------------------------------

Tree = tuple["Tree", ...]  # a rooted tree is the sorted tuple of its branches


def trees(size: int) -> list[Tree]:
    """All rooted trees with `size` nodes."""
    return sorted(set(_forests(size - 1)))


def _forests(size: int) -> Iterator[Tree]:
    """Multisets of rooted trees with `size` nodes in all."""
    if size == 0:
        yield ()
        return
    for parts in _partitions(size, size):
        yield from _chosen(parts)


def _partitions(size: int, largest: int) -> Iterator[dict[int, int]]:
    if size == 0:
        yield {}
        return
    for part in range(min(size, largest), 0, -1):
        for count in range(1, size // part + 1):
            for rest in _partitions(size - part * count, part - 1):
                yield {part: count, **rest}


def _chosen(parts: dict[int, int]) -> Iterator[Tree]:
    if not parts:
        yield ()
        return
    part, count = next(iter(parts.items()))
    rest = {k: v for k, v in parts.items() if k != part}
    for some in combinations_with_replacement(trees(part), count):
        for others in _chosen(rest):
            yield tuple(sorted((*some, *others)))


def density(tree: Tree) -> int:
    """gamma(tau): the product of the sizes of all subtrees."""
    return size_of(tree) * math.prod(density(branch) for branch in tree)


def size_of(tree: Tree) -> int:
    return 1 + sum(size_of(branch) for branch in tree)


def weight(tableau: Tableau, tree: Tree) -> Fraction:
    """Phi(tau) = sum_i b_i prod over the branches."""
    stages = _inner(tableau, tree)
    return sum((b * g for b, g in zip(tableau.b, stages, strict=True)), Fraction(0))


def _inner(tableau: Tableau, tree: Tree) -> list[Fraction]:
    values = [Fraction(1)] * tableau.num_stages
    for branch in tree:
        inner = _inner(tableau, branch)
        for i, row in enumerate(tableau.a):
            values[i] *= sum((a * g for a, g in zip(row, inner[:i], strict=True)), Fraction(0))
    return values


def test_rooted_trees_are_counted() -> None:
    assert [len(trees(n)) for n in range(1, 7)] == [1, 1, 2, 4, 9, 20]


@pytest.mark.parametrize("scheme", tuple(TABLEAUX))
def test_coefficients_satisfy_the_order_conditions(scheme: str) -> None:
    tableau = TABLEAUX[scheme]
    assert tableau.order == ORDER[scheme]
    assert [len(row) for row in tableau.a] == list(range(tableau.num_stages))
    assert len(tableau.c) == tableau.num_stages
    for size in range(1, tableau.order + 1):
        for tree in trees(size):
            assert weight(tableau, tree) == Fraction(1, density(tree)), tree
    higher = [weight(tableau, t) - Fraction(1, density(t)) for t in trees(tableau.order + 1)]
    assert any(higher)  # and no order more


# --- order on the groups ----------------------------------------------------------------------------------

SMALL = [(name, scheme, lie) for name in ("heavy top", "hector") for scheme in ORDER for lie in LIE_METHODS]
LARGE = [("several groups", scheme, lie) for scheme in ORDER for lie in LIE_METHODS]
QUICK = (("dcm", "rk4", "munthe_kaas"),)
STEPS = {"euler": (160, 320), "heun": (40, 80), "rk4": (16, 32), "rkf5": (12, 24)}


def order_cases() -> Iterator[object]:
    for rotations in ROTATIONS:
        for name, scheme, lie in (*SMALL, *LARGE):
            is_quick = name != "several groups" or (rotations, scheme, lie) in QUICK
            marks = [] if is_quick else [pytest.mark.slow]
            yield pytest.param(name, rotations, scheme, lie, marks=marks)


def controls(robot: Robot, u: Array) -> Array:
    """The quadrotor weighs 1.5 kg, and its moments of inertia are a hundredth of that."""
    return 0.02 * u if robot.name == "hector" else u


def off(space: ConfigurationSpace, z: Array, q: Array) -> float:
    """Largest error of coordinates, whichever of the two quaternions q has."""
    (wanted,) = space.coordinates(q[None])
    worst = 0.0
    for part in space.parts:
        got, same = z[part.at_z], wanted[part.at_z].copy()
        has_quaternion = part.group.nz == 7 or isinstance(part.group, Quaternion)
        if has_quaternion and got[-4:] @ same[-4:] < 0:
            same[-4:] *= -1.0
        worst = max(worst, float(np.abs(got - same).max()))
    return worst


@pytest.mark.parametrize(("name", "rotations", "scheme", "lie"), list(order_cases()))
def test_order(name: str, rotations: str, scheme: str, lie: str) -> None:
    """Coordinates and speeds against an adaptive method on Pinocchio's algorithms; drift counts as error."""
    robot, simulate = robot_named(name), Simulation(name, rotations, scheme, lie)
    q, v, u = start_of(robot)
    u = controls(robot, u)
    q_end, v_end = reference(name, q, v, u, DURATION)
    errors = []
    for steps in STEPS[scheme]:
        zs, ss = simulate(simulate.coordinates(q), v, u, DURATION, steps)
        errors.append(max(off(simulate.space, zs[-1], q_end), np.abs(ss[-1] - v_end).max()))
    assert errors[0] > 1e-11  # far above round-off, or the quotient means nothing
    order = np.log2(errors[0] / errors[1])
    assert abs(order - ORDER[scheme]) < 0.2, (errors, order)


@pytest.mark.parametrize("scheme", ["heun", "rk4", "rkf5"])
@pytest.mark.parametrize("name", ["heavy top", "hector"])
def test_quaternions_and_matrices_give_the_same_motion(name: str, scheme: str) -> None:
    """On the group the method knows no coordinates: equal to round-off, not to the method's order."""
    robot = robot_named(name)
    q, v, u = start_of(robot)
    u = controls(robot, u)
    found = []
    for rotations in ROTATIONS:
        simulate = Simulation(name, rotations, scheme, "munthe_kaas")
        zs, ss = simulate(simulate.coordinates(q), v, u, DURATION, 25)
        found.append((simulate.space.configurations(zs), ss))
    (qs, ss), (others, other_ss) = found
    between = [pin.difference(robot.model, a, b) for a, b in zip(qs, others, strict=True)]
    assert np.abs(between).max() < 1e-11
    assert np.allclose(ss, other_ss, rtol=1e-11, atol=1e-11)


@pytest.mark.parametrize("rotations", ROTATIONS)
@pytest.mark.parametrize("lie", LIE_METHODS)
def test_substeps_are_steps(rotations: str, lie: str) -> None:
    q, v, u = start_of(robot_named("heavy top"))
    once = Simulation("heavy top", rotations, "rk4", lie)
    thrice = Simulation("heavy top", rotations, "rk4", lie, substeps=3)
    zs, ss = once(once.coordinates(q), v, u, DURATION, 30)
    coarse, coarse_ss = thrice(thrice.coordinates(q), v, u, DURATION, 10)
    assert np.allclose(zs[::3], coarse, rtol=0, atol=1e-13)
    assert np.allclose(ss[::3], coarse_ss, rtol=0, atol=1e-12)


# --- drift ------------------------------------------------------------------------------------------------


def defects(space: ConfigurationSpace, zs: Array) -> Array:
    z = ca.SX.sym("z", space.nz)
    function = ca.Function("defects", [z], [ca.densify(space.defects(z))])
    found: Array = np.abs(np.asarray(function.map(len(zs))(zs.T)).T)
    return found


@pytest.mark.parametrize("rotations", ROTATIONS)
@pytest.mark.parametrize("name", ["heavy top", "hector"])
def test_steps_on_the_group_keep_it(name: str, rotations: str) -> None:
    """|q| = 1 and R'R = I over 10,000 steps, to round-off that hardly adds up."""
    robot, simulate = robot_named(name), Simulation(name, rotations, "rk4", "munthe_kaas")
    q, v, u = start_of(robot)
    zs, _ = simulate(simulate.coordinates(q), v, 0.1 * controls(robot, u), 10.0, 10_000)
    assert defects(simulate.space, zs).max() < 1e-13


@pytest.mark.parametrize("rotations", ROTATIONS)
def test_steps_in_coordinates_leave_it_by_the_error_of_the_method(rotations: str) -> None:
    q, v, u = start_of(robot_named("heavy top"))
    worst = []
    for lie in ("plain", "baumgarte", "munthe_kaas"):
        simulate = Simulation("heavy top", rotations, "rk4", lie)
        zs, _ = simulate(simulate.coordinates(q), v, u, 20.0, 400)
        worst.append(defects(simulate.space, zs).max())
    assert 1e-7 < worst[1] < worst[0] < 1e-2
    assert worst[2] < 1e-13


def test_a_perturbed_quaternion_returns_at_its_rate() -> None:
    """Eq. (46): d|q|^2/dt = 2 gamma (1 - |q|^2), whatever the motion."""
    q, v, u = start_of(robot_named("heavy top"))
    simulate = Simulation("heavy top", "quaternion", "rkf5", "baumgarte")
    for size in (0.8, 1.1):
        zs, _ = simulate(size * q, v, u, 1.0, 200)
        squares = np.sum(zs**2, axis=1) - 1
        expected = (size**2 - 1) * np.exp(-2 * GAMMAS[0] * np.linspace(0, 1, 201))
        assert np.allclose(squares, expected, rtol=0, atol=1e-9)


def test_a_perturbed_matrix_returns_at_its_rate() -> None:
    """Eq. (47) with its sign mended: eigenvalues s of R'R follow s' = -2 gamma s (s - 1).

    As printed the deviation grows.
    """
    q, v, u = start_of(robot_named("heavy top"))
    simulate = Simulation("heavy top", "dcm", "rkf5", "baumgarte")
    stretch = np.diag([0.9, 1.05, 1.1])
    R = simulate.coordinates(q).reshape(3, 3).T @ stretch
    zs, _ = simulate(R.T.ravel(), v, u, 1.0, 200)
    last = zs[-1].reshape(3, 3).T
    s0 = np.diag(stretch) ** 2
    ratio = (s0 - 1) / s0 * np.exp(-2 * GAMMAS[1])  # (s - 1) / s decays exponentially
    assert np.allclose(np.linalg.eigvalsh(last.T @ last), np.sort(1 / (1 - ratio)), rtol=0, atol=1e-9)
    small = np.linalg.norm(last.T @ last - np.eye(3)) / np.linalg.norm(R.T @ R - np.eye(3))
    assert small == pytest.approx(np.exp(-2.0), rel=0.1)


def test_circles_return_like_quaternions() -> None:
    space = ConfigurationSpace(robot_named("several groups").model, "dcm")
    z = ca.SX.sym("z", space.nz)
    rate = space.rate(z, ca.SX.ones(space.nv)) + space.attraction(z, ca.SX(2.0), ca.SX(1.0))
    for part in space.parts:
        if not isinstance(part.group, (Circle, Plane)):
            continue
        at = part.at_z.stop - 2
        pair, slope = z[at : at + 2], rate[at : at + 2]
        pull = ca.Function("pull", [z], [2 * ca.dot(pair, slope) - 4.0 * (1 - ca.dot(pair, pair))])
        for size in (0.7, 1.3):
            assert abs(float(pull(np.full(space.nz, size)))) < 1e-12


# --- holonomic constraints --------------------------------------------------------------------------------


def constrained_start(name: str) -> tuple[Array, Array, Array]:
    """On the constraint, moving along it."""
    robot = robot_named(name)
    q, v, u = (x.copy() for x in start_of(robot))
    if name == "spherical pendulum":
        q = 5.0 * q / np.linalg.norm(q)
    else:  # the bob to where the rod wants it
        data = robot.model.createData()
        pin.framesForwardKinematics(robot.model, data, q)
        hook = data.oMf[robot.constraints[0].frame_a].translation
        away = q[-3:] - hook
        q[-3:] = hook + 1.5 * away / np.linalg.norm(away)
    jacobian = robot.constraint_jacobian(q)
    v = v - np.linalg.pinv(jacobian) @ (jacobian @ v)
    assert abs(robot.constraint_residual(q)).max() < 1e-14
    return q, v, u


CONSTRAINED = [
    ("spherical pendulum", "quaternion"),
    pytest.param("towed body", "quaternion", marks=pytest.mark.slow),
    pytest.param("towed body", "dcm", marks=pytest.mark.slow),
]


def residuals(simulate: Simulation, zs: Array) -> Array:
    qs = simulate.space.configurations(zs)
    return np.array([simulate.robot.constraint_residual(q) for q in qs])[:, 0]


@pytest.mark.parametrize("scheme", ["heun", "rk4", "rkf5"])
@pytest.mark.parametrize(("name", "rotations"), CONSTRAINED)
def test_projected_accelerations_keep_constraints_to_the_method_s_order(
    name: str, rotations: str, scheme: str
) -> None:
    q, v, u = constrained_start(name)
    simulate = Simulation(name, rotations, scheme, "munthe_kaas")
    drifts = []
    for steps in (40, 80):
        zs, _ = simulate(simulate.coordinates(q), 3 * v, u, 2.0, steps)
        drifts.append(np.abs(residuals(simulate, zs)).max())
    assert 1e-12 < drifts[1] < drifts[0] < 0.5
    assert np.log2(drifts[0] / drifts[1]) > ORDER[scheme] - 0.25


@pytest.mark.parametrize(("name", "rotations"), CONSTRAINED)
def test_stabilised_constraints_return_at_their_rate(name: str, rotations: str) -> None:
    r"""\ddot Phi + 2 gamma \dot Phi + gamma^2 Phi = 0, from beside the constraint."""
    gamma = 3.0
    q, v, u = constrained_start(name)
    q[-3:] += 0.05
    robot, simulate = robot_named(name), Simulation(name, rotations, "rk4", "munthe_kaas")
    phi, rate = robot.constraint_residual(q)[0], (robot.constraint_jacobian(q) @ v)[0]
    t = np.linspace(0, 2, 401)
    for g, atol in ((gamma, 1e-6), (0.0, 1e-6)):
        zs, _ = simulate(simulate.coordinates(q), v, u, 2.0, 400, (*GAMMAS[:2], g))
        expected = (phi + (rate + g * phi) * t) * np.exp(-g * t)
        assert np.allclose(residuals(simulate, zs), expected, rtol=0, atol=atol)


@pytest.mark.parametrize("rotations", ROTATIONS)
def test_multipliers_are_those_of_the_accelerations(rotations: str) -> None:
    """M a = force - bias - Phi_q' lambda, and the accelerations stay on the constraint."""
    name = "spherical pendulum"
    mechanics, robot = mechanics_of(name, rotations), robot_named(name)
    q, v, u = constrained_start(name)
    zq, zv, zu = ca.SX.sym("q", mechanics.nq), ca.SX.sym("v", mechanics.nv), ca.SX.sym("u", mechanics.nu)
    rate = mechanics.speed_rate(zq, zv, zu, ca.SX(0.0))
    function = ca.Function("f", [zq, zv, zu], [rate, mechanics.multipliers(zq, zv, zu, ca.SX(0.0))])
    a, lam = (np.asarray(out).ravel() for out in function(q, v, u))
    data = robot.model.createData()
    left = pin.rnea(robot.model, data, q, v, a) + robot.constraint_jacobian(q).T @ lam
    assert np.allclose(left, robot.actuation_matrix(q) @ u, rtol=0, atol=1e-12)
    assert abs(q @ a + v @ v) < 1e-12  # the second derivative of |q|^2 / 2
