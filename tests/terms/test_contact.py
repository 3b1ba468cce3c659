"""Contact forces: what they are, by Pinocchio; bounds that are active; derivatives; what is refused."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import casadi as ca
import numpy as np
import pinocchio as pin
import pytest

from mbocp import Solution, load_problem, solve
from mbocp.exceptions import MbocpError
from mbocp.formulation import formulate
from mbocp.integrators import TAU, evaluation_points
from mbocp.problem import ContactForce, Problem, parse_problem, problem_to_toml
from mbocp.problem.timeline.hold import Hold
from tests.robot.urdfs import write
from tests.terms.contacts import BODY, FEET, FOOT, GRAVITY, HOPPER, hopper, on_feet, on_ground, solo

EXAMPLES = Path(__file__).parents[2] / "examples"
DOWN = [{"share": 0.5, "frame": {"name": "solo/base_link", "z": 0.165}}]
WELDED = {
    "robot": {
        "part": [{"name": "arm", "robot": "ur5"}, {"name": "load", "mass": 3.0, "box": [0.1, 0.1, 0.1]}],
        "constraint": [{"name": "grip", "type": "weld", "frames": ["load/body", "arm/tool0"]}],
        "initial": {"q": {"arm": [0, -1.57, 1.57, -1.57, -1.57, 0]}},
    },
    "duration": 0.5,
    "steps": 6,
    "goal": {"v": 0},
    "cost": {"effort": 1e-3},
}
GRIPPED = {"kind": "contact_force", "name": "hand", "constraint": "grip"}
EVERYTHING = {
    "friction": 0.6,
    "max": 90.0,
    "pressure": [0.08, 0.06],
    "yaw_friction": 0.03,
    "max_normal": 50.0,
}


def forces(problem: Problem, solution: Solution) -> dict[str, np.ndarray]:
    """Force and torque along the normal and two tangents in each step, by contact."""
    return {c.name: c.wrenches(solution.lams) for c in problem.contacts}


@pytest.fixture(scope="module")
def squat() -> tuple[Problem, Solution]:
    """On slippery ground, so that all cones are active."""
    problem = solo(via=DOWN, path=on_feet(friction=0.1), limits={"effort": 2.5}, steps=6)
    return problem, solve(problem)


def test_forces_are_those_of_inverse_dynamics(squat: tuple[Problem, Solution]) -> None:
    """With the same q, v, a and torques: Pinocchio's inverse dynamics, and Jacobians of the feet."""
    problem, solution = squat
    assert solution.converged
    assert solution.residual < 1e-8
    robot, dts = problem.robot, np.full(problem.num_steps, problem.dt)
    model, data = robot.model, robot.model.createData()
    q_at, v_at = evaluation_points(robot, TAU[problem.scheme], solution.qs, solution.vs, dts)
    feet = [model.getFrameId(f"solo/{name}_FOOT") for name in FEET]
    found = forces(problem, solution)
    for n, (q, v) in enumerate(zip(q_at, v_at, strict=True)):
        a = (solution.vs[n + 1] - solution.vs[n]) / dts[n]
        missing = pin.rnea(model, data, q, v, a)
        missing[6:] -= solution.us[n]
        pin.computeJointJacobians(model, data, q)
        pin.updateFramePlacements(model, data)
        J = np.vstack([pin.getFrameJacobian(model, data, i, pin.LOCAL_WORLD_ALIGNED)[:3] for i in feet])
        expected, *_ = np.linalg.lstsq(J.T, missing, rcond=None)
        own = np.array([found[name][n, [1, 2, 0]] for name in FEET])  # tangents are x and y
        assert np.allclose(own.ravel(), expected, rtol=0, atol=1e-8)
        pin.computeCentroidalMomentumTimeVariation(model, data, q, v, a)
        weight = pin.computeTotalMass(model) * np.array([0, 0, 9.81])
        assert np.allclose(own.sum(axis=0), data.dhg.linear + weight, rtol=0, atol=1e-8)


def test_cones_are_kept_and_their_multipliers_say_what_friction_is_worth(
    squat: tuple[Problem, Solution],
) -> None:
    """Where all multipliers are right the cost changes by the sum of lambda dg/dmu."""
    problem, solution = squat
    for f in forces(problem, solution).values():
        assert np.all(np.linalg.norm(f[:, 1:3], axis=1) <= 0.1 * f[:, 0] + 1e-8)
    assert solution.limit_violation < 1e-8
    columns = [i for i, name in enumerate(solution.path_names) if name.endswith(".cone")]
    lam = solution.lam_path[:, columns]
    assert np.all(lam <= 1e-9)  # of lower bounds
    assert (lam < -1e-6).all(axis=1).any()
    normals = np.column_stack([f[:, 0] for f in forces(problem, solution).values()])
    expected, step = float((lam * normals).sum()), 1e-4
    more, less = (solve(problem.with_(path=on_feet(friction=mu))).cost for mu in (0.1 + step, 0.1 - step))
    assert (more - less) / (2 * step) == pytest.approx(expected, rel=1e-3)


def test_the_ground_does_not_pull(tmp_path: Path) -> None:
    """A body that rises and stops faster than it would fall asks the ground to pull: it may not."""
    free = hopper(tmp_path, path=on_ground(min_normal=-1e6))
    pulled = forces(free, solve(free))["ground force"][:, 0]
    assert pulled.min() < -5.0
    problem = hopper(tmp_path, path=on_ground(min_normal=0.0))
    solution = solve(problem, check=True)
    normal = forces(problem, solution)["ground force"][:, 0]
    assert normal.min() == pytest.approx(0.0, abs=1e-5)  # [N] of hundreds, by an interior-point method
    acceleration = np.diff(solution.vs[:, 0]) / problem.dt
    assert np.allclose(normal, BODY * (acceleration + GRAVITY) + FOOT * GRAVITY, rtol=0, atol=1e-8)
    lam = solution.lam_path[:, 0]
    assert np.abs(lam * normal).max() < 1e-6
    assert lam.min() < -1e-6
    assert lam.max() < 1e-9
    other = solve(problem, solver="ipopt")
    assert other.cost == pytest.approx(solution.cost, rel=1e-7)
    assert np.allclose(other.us, solution.us, rtol=0, atol=1e-4)
    step = 0.1
    more, less = (solve(hopper(tmp_path, path=on_ground(min_normal=b))).cost for b in (step, -step))
    assert (more - less) / (2 * step) == pytest.approx(-lam.sum(), rel=1e-3)


@pytest.mark.parametrize(
    "words", [{"scheme": s} for s in ("se1", "se2", "midpoint")] + [{"coordinates": "natural"}]
)
def test_every_scheme_and_natural_coordinates(words: dict[str, str], tmp_path: Path) -> None:
    """To the error of the steps they ask for the same forces."""
    problem = hopper(tmp_path, path=on_ground(min_normal=0.0), **words)
    solution = solve(problem, check=True)
    normal = forces(problem, solution)["ground force"][:, 0] if "scheme" in words else None
    if normal is not None:
        acceleration = np.diff(solution.vs[:, 0]) / problem.dt
        assert np.allclose(normal, BODY * (acceleration + GRAVITY) + FOOT * GRAVITY, rtol=0, atol=1e-6)
        assert normal.min() > -1e-6
    reference = solve(hopper(tmp_path, path=on_ground(min_normal=0.0)))
    assert solution.cost == pytest.approx(reference.cost, rel=0.1)
    assert solution.limit_violation < 1e-6
    assert any("normal" in str(a) for a in solution.active_limits)


def test_steps_of_free_length(tmp_path: Path) -> None:
    """Forces are impulses by the length that is found."""
    duration = {"min": 0.1, "max": 0.4, "guess": 0.3}
    path = on_ground(min_normal=0.0, max_normal=90.0)
    problem = hopper(tmp_path, path=path, duration=duration, cost={"effort": 1e-5, "time": 1.0})
    solution = solve(problem, check=True)
    normal = forces(problem, solution)["ground force"][:, 0]
    dts = np.diff(solution.t)
    acceleration = np.diff(solution.vs[:, 0]) / dts
    assert np.allclose(normal, BODY * (acceleration + GRAVITY) + FOOT * GRAVITY, rtol=0, atol=1e-7)
    assert normal.max() == pytest.approx(90.0, abs=1e-4)
    assert normal.min() == pytest.approx(0.0, abs=1e-4)


def test_a_pyramid_is_within_its_cone(squat: tuple[Problem, Solution]) -> None:
    """All of it; and it reaches as far as its facets let it."""
    contact = squat[0].contacts[0]
    force = np.random.default_rng(1).normal(size=(4000, 12)) * np.tile([0.1, 0.1, -1], 4)
    cone = contact.values_of(force)[:, 1]
    for facets in (3, 4, 64):
        bounds = replace(contact, contact=replace(contact.contact, facets=facets))
        values = bounds.values_of(force)
        inside = values[:, 1:].min(axis=1) >= 0.0
        assert np.all(cone[inside] >= 0.0)
        assert np.all(inside[cone >= 0.1 * (1 - np.cos(np.pi / facets)) * np.abs(values[:, 0])])
        assert 0 < inside.sum() <= (cone >= 0.0).sum()


def test_forces_count_by_the_weight_of_the_lighter_body() -> None:
    """A box of one kilogram, which an arm of twenty grips beside tables of ten, weighs about 2^3 N."""
    problem = load_problem(EXAMPLES / "arms" / "pick_and_place.toml")
    assert [(contact.source.constraint.name, contact.scale) for contact in problem.contacts] == [
        ("grip", 8.0),
        ("on the table", 8.0),
    ]


def test_what_a_hand_carries() -> None:
    """The weight of what is welded to it, and its torques: the centre of pressure by the lever rule."""
    problem = Problem.create(**{"integrator": {"scheme": "se1"}, **WELDED}, path=[{**GRIPPED, **EVERYTHING}])
    (contact,) = problem.contacts
    values = dict(zip((label.name for label in contact.labels), contact.lower, strict=True))
    assert list(values) == [
        *(f"hand.{word}" for word in ("normal", "cone", "size", "pressure_1_upper", "pressure_1_lower")),
        *(f"hand.{word}" for word in ("pressure_2_upper", "pressure_2_lower", "yaw_upper", "yaw_lower")),
    ]
    # 20 N along the normal, 3 cm off along x and -1 cm along y, and 0.5 N m about the normal
    force, at = np.array([2.0, 1.0, 20.0]), np.array([0.03, -0.01, 0.0])
    lams = -np.concatenate([force, np.cross(at, force) + np.array([0, 0, 0.5])])[None]
    found = contact.values_of(lams)[0]
    turn = 0.5 + np.cross(at, force)[2]
    centre = [20 * (0.04 - 0.03), 20 * (0.04 + 0.03), 20 * (0.03 + 0.01), 20 * (0.03 - 0.01)]
    yaw = [0.6 - turn, 0.6 + turn]
    assert np.allclose(found[[0, 1, 2, 7, 8]], [20.0, 12.0 - 5**0.5, 405**0.5, *yaw])
    assert np.allclose(np.sort(found[3:5]), np.sort(centre[:2]))
    assert np.allclose(np.sort(found[5:7]), np.sort(centre[2:]))


@pytest.mark.parametrize("keys", [EVERYTHING, {"friction": 0.6, "facets": 5, "normal": [1, 2, 2]}])
def test_derivatives_and_values(keys: dict[str, Any]) -> None:
    """Against differences; values against the expression that solvers see; slopes against both."""
    problem = Problem.create(**{"integrator": {"scheme": "se1"}, **WELDED}, path=[{**GRIPPED, **keys}])
    formulation = formulate(problem)
    programme, at, (contact,) = formulation.programme, formulation.layout, problem.contacts
    rng, h = np.random.default_rng(2), programme.functions.function("path")
    x = programme.x_start + 0.1 * rng.standard_normal(at.nx)
    reaction = at.states["reaction"]
    x[reaction] = rng.standard_normal(6)
    m, u = rng.standard_normal(contact.rows), np.zeros(programme.kind.nu)

    def values(x: np.ndarray) -> np.ndarray:
        return np.asarray(h(x, m, u, programme.theta)[0]).ravel()

    found, slope, upper = (np.asarray(ca.DM(o).full()) for o in h(x, m, u, programme.theta))
    steps = 1e-6 * np.eye(at.nx)
    differences = np.array([(values(x + d) - values(x - d)) / 2e-6 for d in steps]).T
    assert np.allclose(slope, differences, rtol=0, atol=1e-8)

    def gradient(x: np.ndarray) -> np.ndarray:
        return m @ np.asarray(ca.DM(h(x, m, u, programme.theta)[1]).full())

    second = np.array([gradient(x + d) - gradient(x - d) for d in steps]) / 2e-6
    assert np.allclose(np.triu(second), upper, rtol=0, atol=1e-7)
    lams = contact.scale * x[reaction][None]
    spoken = contact.values_of(lams)
    lower, _ = contact.inner_bounds
    at_bound = np.sign(spoken[0] - np.where(np.isfinite(contact.lower), contact.lower, contact.upper))
    inner = found.ravel() - np.where(np.isfinite(lower), lower, contact.inner_bounds[1])
    assert np.array_equal(at_bound, np.sign(inner))
    rows = [i for i, label in enumerate(contact.labels) if label.name != "hand.cone"]
    d = 1e-6 * rng.standard_normal(6)
    near = x.copy()
    near[reaction] += d
    change = (contact.values_of(contact.scale * near[reaction][None]) - spoken)[0]
    expected = contact.slopes(spoken)[0] * change
    assert np.allclose((values(near) - values(x))[rows], expected[rows], rtol=0, atol=1e-10)


def test_problem_files_read_back() -> None:
    span = {"from": {"share": 0.25}, "until": {"share": 0.5}}
    path = [{**GRIPPED, **EVERYTHING, **span}, {**GRIPPED, "name": "limit", "max": 90.0, "normal": [0, 1, 0]}]
    problem = Problem.create(**{"integrator": {"scheme": "se1"}, **WELDED}, path=path)
    text = problem_to_toml(problem)
    again = parse_problem(text)
    assert [c.contact for c in again.contacts] == [c.contact for c in problem.contacts]
    assert problem_to_toml(again) == text
    assert [c.contact for c in problem.with_(duration=0.7).contacts] == [c.contact for c in problem.contacts]
    assert problem.contacts[0].contact.normal_bounds == (0.0, 50.0)
    nodes = problem.contacts[0].span.nodes(problem.num_steps, problem.dt)
    assert nodes.tolist() == [False, True, True, False, False, False]


REFUSED: list[tuple[str, dict[str, Any], str]] = [
    ("point", {"friction": 0.0}, "friction: got 0.*a positive number"),
    ("point", {"friction": -0.5}, "friction: got -0.5"),
    ("point", {"constraint": "grond", "friction": 0.5}, "no constraint 'grond'.*ground"),
    ("point", {"frame": "foot", "friction": 0.5}, "does not use it; name the constraint"),
    (
        "point",
        {"x": [0, 1], "friction": 0.5},
        'kind = "contact_force" does not use it, but .*constraint',
    ),
    ("point", {}, "bounds nothing; give friction"),
    ("point", {"facets": 4, "max": 3.0}, "facets of which cone"),
    ("point", {"facets": 2, "friction": 0.3}, "at least 3"),
    ("point", {"facets": 1000, "friction": 0.3}, "at most 64"),
    ("point", {"friction": 0.3, "min_normal": -1.0}, "a force >= 0 beside friction"),
    ("point", {"min_normal": 3.0, "max_normal": 1.0}, "the lower not above the upper"),
    ("point", {"normal": [0, 0, 0], "friction": 0.3}, "three finite numbers, not all zero"),
    ("point", {"pressure": [0.1, 0.1]}, "pressure: a point exerts no such torque; a weld does"),
    ("point", {"pressure": [0.1, -0.1]}, "pressure: got -0.1"),
    ("point", {"yaw_friction": 0.1}, "yaw_friction: a point exerts no such torque"),
    ("plane", {"friction": 0.3}, "a plane lets the frame slide and has no friction"),
    ("plane", {"normal": [0, 0, 1], "min_normal": 0.0}, "a plane has its own"),
    ("line", {"min_normal": 0.0, "normal": [1, 0, 0]}, "no force along its axis; give one across it"),
]


@pytest.mark.parametrize(("kind", "keys", "message"), REFUSED)
def test_what_is_refused(kind: str, keys: dict[str, Any], message: str, tmp_path: Path) -> None:
    path = on_ground(**keys)
    with pytest.raises(MbocpError, match=message):
        hopper(tmp_path, kind, "axis = [1, 0, 0]" if kind == "line" else "", path=path)


def test_what_is_refused_of_robots_and_schemes(tmp_path: Path) -> None:
    with pytest.raises(MbocpError, match="has no constraints that exert forces; hold a frame"):
        Problem.create("ur5", 1.0, 8, path=on_ground(friction=0.5))
    with pytest.raises(MbocpError, match='scheme = "rk4" projects accelerations'):
        hopper(tmp_path, path=on_ground(min_normal=0.0), scheme="rk4")
    with pytest.raises(MbocpError, match=r"path\.0\.constraint: this key is missing"):
        hopper(tmp_path, path=[{"kind": "contact_force", "friction": 1.0}])
    with pytest.raises(MbocpError, match=r"path\.0\.frame: this key is missing"):
        hopper(tmp_path, path=[{"kind": "position", "z": [0, 1]}])
    geared = '[[constraint]]\ntype = "coupling"\nname = "ground"\njoints = ["height", "leg"]\nratio = -1.0\n'
    path = write(tmp_path / "geared", HOPPER, geared)
    with pytest.raises(MbocpError, match="the coupling 'ground' joins two joints"):
        Problem.create(str(path), 0.2, 20, path=on_ground(max=1.0))
    with pytest.raises(MbocpError, match="fbsm_newton"):
        hopper(tmp_path, path=on_ground(min_normal=0.0), solver={"method": "fbsm_newton"})


def test_a_jump(tmp_path: Path) -> None:
    """The ground pushes as long as the foot is held, and not afterwards: then the body falls freely."""
    goal = {"q": {"height": 0.12, "leg": 0.0}}
    problem = hopper(tmp_path, "", goal=goal, duration=0.4, cost={"effort": 1e-3})
    held = Hold(name="stance", frame="foot", kind="plane", spans=((0, 12),))
    bounds = ContactForce(name="ground force", constraint="stance", min_normal=0.0, max_normal=55.0)
    problem = problem.with_(holds=(held,), path=(bounds,))
    solution = solve(problem, check=True)
    normal = forces(problem, solution)["ground force"][:, 0]
    assert normal[:12].min() > -1e-6
    assert normal[:12].max() == pytest.approx(55.0, abs=1e-4)
    assert not normal[12:].any()
    body = solution.vs[:, 0]
    momentum = BODY * body + FOOT * solution.vs.sum(axis=1)
    assert np.allclose(np.diff(momentum) / problem.dt, normal - (BODY + FOOT) * GRAVITY, rtol=0, atol=1e-8)
    assert solution.limit_violation < 1e-6
    with pytest.raises(MbocpError, match=r"no constraint 'stand'.*stance"):
        problem.with_(path=(replace(bounds, constraint="stand"),))
