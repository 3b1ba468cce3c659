"""Free starts and periodic motions: what holds at an optimum, cycles that are known, impacts, refusals."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
import pytest
from numpy.typing import NDArray
from scipy.integrate import solve_ivp
from scipy.optimize import brentq, fsolve
from scipy.special import ellipk

from mbocp import Problem, Solution, load_problem, load_robot, solve
from mbocp._files import parse_toml
from mbocp.exceptions import MbocpError
from mbocp.lie import ConfigurationSpace
from mbocp.problem.file.tables import tables_of, to_toml
from mbocp.problem.goals.periodic import Periodic, point_jacobian
from mbocp.problem.problem import problem_from_tables

EXAMPLES = Path(__file__).parents[1] / "examples"
Vector = NDArray[np.float64]
BOB = """<robot name="swing"><link name="world"/>
<link name="bob"><inertial><origin xyz="0 0 -1"/><mass value="1"/>
<inertia ixx="0" iyy="0" izz="0" ixy="0" ixz="0" iyz="0"/></inertial></link>
<joint name="hinge" type="revolute"><parent link="world"/><child link="bob"/><axis xyz="0 1 0"/>
<limit lower="-6" upper="6" effort="100" velocity="100"/></joint></robot>"""


@pytest.fixture(scope="module")
def swing(tmp_path_factory: pytest.TempPathFactory) -> str:
    """A pendulum of 1 m and 1 kg."""
    path = tmp_path_factory.mktemp("robots") / "swing.urdf"
    path.write_text(BOB)
    return str(path)


def solved(problem: Problem, **how: Any) -> Solution:
    solution = solve(problem, **how)
    assert solution.converged, solution.advice
    return solution


def amplitude(period: float) -> float:
    """Of a pendulum of 1 m that swings with this period."""
    return float(brentq(lambda a: 4 * np.sqrt(1 / 9.81) * ellipk(np.sin(a / 2) ** 2) - period, 0.1, 3.0))


@pytest.mark.parametrize("change", [{}, {"goal": {"a": "free"}}])
def test_accelerations_and_torques_do_not_leap_where_a_cycle_closes(swing: str, change: Any) -> None:
    """From the end of a repetition to the start of the next, as far as it is not said to be free."""
    limits = {"jerk": 150.0, "effort_rate": 400.0}
    start = {"q": [0.6], "free": "v", "u": [2.0]}
    problem = Problem.create(swing, 1.6, 16, start=start, goal={"periodic": True}, limits=limits)
    motion = solved(problem.with_(via=[{"time": 0.8, "q": [-0.6]}], **change))
    rates, torques = np.diff(motion.vs[:, 0]) / 0.1, motion.us[:, 0]
    leaps = np.abs([rates[0], rates[-1]]) / 0.05, np.abs([torques[0] - 2.0, torques[-1] - 2.0]) / 0.05
    assert leaps[0][0] <= 150.0 + 1e-5
    assert (leaps[1] <= 400.0 + 1e-5).all()
    assert (leaps[0][1] <= 150.0 + 1e-5) == (not change)


@pytest.mark.parametrize("method", ["monolithic", "ipopt", "fbsm_newton"])
def test_free_oscillation(swing: str, method: str) -> None:
    """A cycle without effort is a free oscillation; its amplitude that of the elliptic integral, to dt^2."""
    period, errors = 2.5, []
    for steps in (40, 80):
        problem = Problem.create(
            swing,
            period,
            steps,
            start={"q": [1.7], "free": {"q": ["hinge"]}},
            goal={"periodic": True},
            cost={"effort": 1.0},
            guess={"u": [0.0]},
            scheme="midpoint",
            solver={"method": method},
        )
        s = solved(problem)
        assert s.cost < 1e-20
        assert np.allclose(s.qs[-1], s.qs[0], atol=1e-12)
        assert np.allclose(s.vs[-1], s.vs[0], atol=1e-12)
        errors.append(s.qs[0, 0] - amplitude(period))
    assert errors[0] / errors[1] == pytest.approx(4.0, abs=0.1)
    assert abs(errors[1]) < 1e-3
    assert s.goal_error.startswith("a cycle, closed to ")


@pytest.mark.parametrize("scheme", ["se1", "midpoint", "rk4"])
def test_transversality(scheme: str) -> None:
    """Where the start is free its adjoint vanishes; others find the same start."""
    goal, cost = {"q": [1.0, 0.5], "v": 0}, {"effort": 1.0, "velocity": 0.1}
    problem = Problem.create(
        "double_pendulum", 0.6, 24, start={"free": "v"}, goal=goal, cost=cost, scheme=scheme
    )
    own = solved(problem, solver="monolithic")
    nv = problem.robot.nv
    assert np.abs(own.vs[0]).max() > 0.1
    assert np.abs(own.mus[0][nv:]).max() < 1e-9 < np.abs(own.mus[0][:nv]).max()
    other = solved(problem, solver="ipopt")
    assert np.allclose(other.qs, own.qs, atol=1e-8)
    assert np.allclose(other.vs[0], own.vs[0], atol=1e-7)
    given = solved(problem.with_(start={"free": None}))
    assert own.cost < given.cost
    again = solved(problem.with_(start={"v": own.vs[0], "free": None}), warm_start=own)
    assert again.cost == pytest.approx(own.cost, rel=1e-10)
    warm = solved(problem, warm_start=own)
    assert warm.iterations <= 3
    assert np.allclose(warm.vs[0], own.vs[0], atol=1e-8)


def test_bounds_of_the_start() -> None:
    """An active bound holds the entry, and its adjoint points outwards; limits count at the start, too."""
    first, second = (label.name for label in load_robot("double_pendulum").v_labels)
    goal, cost = {"q": [1.0, 0.5], "v": 0}, {"effort": 1.0, "velocity": 0.1}
    words: dict[str, Any] = {"goal": goal, "cost": cost, "solver": "monolithic"}
    free = solved(
        Problem.create(
            "double_pendulum", 0.6, 24, start={"free": "v"}, **{"integrator": {"scheme": "se1"}, **words}
        )
    )
    half = float(free.vs[0, 0]) / 2
    bounds = {first: sorted([0.0, half]), second: True}
    s = solved(
        Problem.create(
            "double_pendulum",
            0.6,
            24,
            start={"free": {"v": bounds}},
            **{"integrator": {"scheme": "se1"}, **words},
        )
    )
    assert s.vs[0, 0] == pytest.approx(half, abs=1e-4)  # as near as the last barrier lets it
    robot = load_robot("double_pendulum")
    costate = robot.mass_matrix(s.qs[0]) @ s.mus[0, 2:]
    assert costate[0] * np.sign(half) < -1e-6
    assert abs(costate[1]) < 1e-2 * abs(costate[0])
    limits = {"velocity": float(np.abs(free.vs[0]).max()) / 2}
    limited = solve(
        Problem.create(
            "double_pendulum",
            0.6,
            24,
            start={"free": "v"},
            limits=limits,
            **{"integrator": {"scheme": "se1"}, **words},
        )
    )
    assert np.abs(limited.vs[0]).max() <= limits["velocity"] + 1e-8


def test_closed_loops_hold_at_a_free_start() -> None:
    problem = Problem.create(
        "four_bar",
        0.5,
        20,
        start={"free": "v"},
        goal={"q": {"crank": 2.0}, "v": {"crank": 0.0}},
        cost={"effort": 1.0, "velocity": 0.1},
        scheme="midpoint",
    )
    s, G = solved(problem), problem.robot.constraint_jacobian(problem.q_start)
    assert np.abs(s.vs[0]).max() > 0.1
    assert np.abs(G @ s.vs[0]).max() < 1e-9
    along = np.linalg.svd(G)[2][problem.robot.nc :]  # where the adjoint of the velocity vanishes
    costate = problem.robot.mass_matrix(problem.q_start) @ s.mus[0][problem.robot.nv :]
    assert np.abs(along @ costate).max() < 1e-9 < np.abs(costate).max()


def test_a_cycle_on_the_group() -> None:
    """A rigid body comes back to the pose and the velocity with which it began, on the group."""
    pose = {"name": "base_link", "position": [0.3, 0.4, 0.1], "rpy": [0.2, 0.0, 0.8]}
    problem = Problem.create(
        {"name": "hector", "actuated": ["root_joint"]},
        1.0,
        30,
        start={"q": [0, 0, 0, 0, 0, 0, 1], "free": "v"},
        goal={"periodic": True},
        via=[{"name": "there", "share": 0.5, "frame": pose}],
        cost={"effort": 1.0, "velocity": 1.0},
        solver="monolithic",
        scheme="se1",
    )
    s = solved(problem)
    assert np.abs(problem.robot.difference(s.qs[0], s.qs[-1])).max() < 1e-9
    assert np.allclose(s.vs[0], s.vs[-1], atol=1e-9)
    assert np.abs(s.vs[0]).max() > 0.1
    rest = solved(problem.with_(start={"free": None}))
    assert s.cost < rest.cost
    assert np.allclose(rest.vs[-1], 0.0, atol=1e-9)


def test_se2_gives_the_start_of_loops() -> None:
    problem = Problem.create("four_bar", 1.0, 10, start={"free": "v"}, scheme="se2", goal={"v": 0})
    with pytest.raises(MbocpError, match="scheme se2 begins with a velocity"):
        solve(problem)


# The compass gait by the equations of [Goswami1998], with angles (swinging, standing) from the vertical.
M, M_HIP, A, B, G, SLOPE = 5.0, 10.0, 0.5, 0.5, 9.81, np.radians(3.0)
LEG = A + B


def swing_phase(t: float, x: Vector) -> Vector:
    apart = x[1] - x[0]
    coupled = -M * LEG * B * np.cos(apart)
    mass = np.array([[M * B**2, coupled], [coupled, (M_HIP + M) * LEG**2 + M * A**2]])
    rates = M * LEG * B * np.sin(apart) * np.array([x[3] ** 2, -(x[2] ** 2)])
    gravity = G * np.array([M * B * np.sin(x[0]), -(M_HIP * LEG + M * A + M * LEG) * np.sin(x[1])])
    return np.append(x[2:], np.linalg.solve(mass, -rates - gravity))


def return_map(x: Vector) -> tuple[float, Vector]:
    """When the swinging foot touches the ground ahead, and the state after impact and exchange."""

    def height(t: float, x: Vector) -> float:
        return float(x[0] + x[1] + 2 * SLOPE)

    run = solve_ivp(swing_phase, (0, 1.5), x, events=[height], rtol=1e-11, atol=1e-12)
    k = int(np.flatnonzero(run.t_events[0] > 0.4)[0])  # the foot scuffs the ground before, as legs pass
    t, x = float(run.t_events[0][k]), run.y_events[0][k]
    c = np.cos(x[1] - x[0])
    before = np.array([[-M * A * B, -M * A * B + (M_HIP * LEG**2 + 2 * M * A * LEG) * c], [0, -M * A * B]])
    after = np.array(
        [
            [M * B * (B - LEG * c), M * LEG * (LEG - B * c) + M * A**2 + M_HIP * LEG**2],
            [M * B**2, -M * B * LEG * c],
        ]
    )
    return t, np.concatenate([x[1::-1], np.linalg.solve(after, before @ x[2:])])


def in_angles_from_the_vertical(s: Solution) -> Vector:
    """State of the start in the literature's coordinates."""
    q, v = s.qs[0], s.vs[0]
    return np.array([-(q[2] + q[3]) - SLOPE, -q[2] - SLOPE, -(v[2] + v[3]), -v[2]])


@pytest.fixture(scope="module")
def gaits() -> tuple[Problem, list[Solution]]:
    problem = load_problem(EXAMPLES / "walking" / "compass_gait.toml")
    return problem, [solved(problem.with_(num_steps=n)) for n in (160, 320)]


def test_passive_walking(gaits: tuple[Problem, list[Solution]]) -> None:
    """No effort; period and state converge with dt^2 to the fixed point of the return map."""
    _, (coarse, fine) = gaits
    for s in (coarse, fine):
        assert s.cost < 1e-20
        assert np.abs(s.us).max() < 1e-10
    found = [in_angles_from_the_vertical(s) for s in (coarse, fine)]
    start = fsolve(
        lambda x: return_map(np.array([x[0], -2 * SLOPE - x[0], *x[1:]]))[1][[0, 2, 3]] - x,
        found[1][[0, 2, 3]],
        xtol=1e-12,
    )
    known = np.array([start[0], -2 * SLOPE - start[0], *start[1:]])
    period = return_map(known)[0]
    assert known == pytest.approx([-0.3234, 0.2187, -0.3774, -1.0924], abs=1e-4)
    assert period == pytest.approx(0.7343, abs=1e-4)
    errors = [np.append(x - known, s.duration - period) for x, s in zip(found, (coarse, fine), strict=True)]
    assert np.abs(errors[0]).max() < 1e-4
    assert np.allclose(errors[0] / errors[1], 4.0, atol=0.8)
    limit = (4 * found[1] - found[0]) / 3
    assert np.abs(limit - known).max() < 1e-6
    assert np.abs(return_map(limit)[1] - limit).max() < 1e-6
    assert (4 * fine.duration - coarse.duration) / 3 == pytest.approx(period, abs=1e-6)
    stride = fine.qs[-1, 0] - fine.qs[0, 0]
    assert stride == pytest.approx(2 * LEG * np.sin((known[1] - known[0]) / 2), abs=1e-4)


def test_the_impact_keeps_what_it_must(gaits: tuple[Problem, list[Solution]]) -> None:
    """The change of momentum is an impulse at the foot that lands alone, which stops; energy is lost."""
    problem, (s, _) = gaits
    robot, periodic = problem.robot, problem.goal.periodic
    assert periodic is not None
    q, v = s.qs[-1], s.vs[-1]
    after = periodic.after_impact(robot, q, v)
    J = point_jacobian(robot, "swinging_foot", q)
    impulse = robot.mass_matrix(q) @ (after - v)
    assert np.abs(J @ after).max() < 1e-12
    pushed = np.linalg.lstsq(J.T, impulse, rcond=None)[0]
    assert np.abs(J.T @ pushed - impulse).max() < 1e-12 * np.abs(impulse).max()
    assert impulse[3] - (J.T @ pushed)[3] == pytest.approx(0.0, abs=1e-12)
    assert after @ robot.mass_matrix(q) @ after < v @ robot.mass_matrix(q) @ v
    assert np.abs(periodic.defect(robot, (s.qs[0], s.vs[0]), (q, v))).max() < 1e-9


def test_ipopt_walks_the_same(gaits: tuple[Problem, list[Solution]]) -> None:
    problem, (s, _) = gaits
    other = solved(problem.with_(num_steps=s.num_steps), solver="ipopt", warm_start=s)
    assert np.allclose(other.qs, s.qs, atol=1e-6)
    assert other.duration == pytest.approx(s.duration, abs=1e-7)


@pytest.mark.parametrize(
    "periodic",
    [
        {"swap": [["elbow_joint", "wrist_1_joint"]], "mirror": ["elbow_joint"]},
        {"moved": {"elbow_joint": 0.3}},
    ],
)
def test_images_by_hand(periodic: dict[str, Any]) -> None:
    problem = Problem.create("ur5", 1.0, 10, start={"free": True}, goal={"periodic": periodic}, scheme="se1")
    image, q = problem.goal.periodic.image(problem.robot), np.arange(1.0, 7.0) / 10  # type: ignore[union-attr]
    wanted = q.copy()
    if "swap" in periodic:
        wanted[2], wanted[3] = -q[3], q[2]
    else:
        wanted[2] += 0.3
    assert np.allclose(image.configuration(q), wanted)


CART = """<robot name="cart"><link name="world"/>
<link name="cart"><inertial><mass value="2"/>
<inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial></link>
<joint name="root_joint" type="planar"><parent link="world"/><child link="cart"/><axis xyz="0 0 1"/></joint>
</robot>"""
MOVES: dict[str, dict[str, Any]] = {
    "solo12": {"root_joint": {"x": 0.3, "y": -0.1, "z": 0.02, "yaw": 0.7}},
    "solo12, reflected": {"root_joint": {"x": 0.3, "yaw": 0.7}},
    "planar": {"root_joint": {"x": 0.3, "y": 0.2, "yaw": -1.2}},
    "planar, reflected": {"root_joint": {"y": 0.2, "yaw": 0.4}},
}


@pytest.mark.parametrize("coordinates", ["quaternion", "dcm"])
@pytest.mark.parametrize("case", MOVES)
def test_bases_are_reflected_turned_and_moved(case: str, coordinates: str, tmp_path: Path) -> None:
    """The image of a base is that of its placement, and that of its velocity the derivative."""
    kind, _, reflected = case.partition(", ")
    path = tmp_path / "cart.urdf"
    path.write_text(CART)
    robot, rng = load_robot(kind if kind == "solo12" else str(path)), np.random.default_rng(3)
    periodic = Periodic(moved=MOVES[case], mirror=("root_joint",) if reflected else ())
    periodic.check(robot)
    image, base = periodic.image(robot), robot.joint_names[0]
    far = {"x": 0.0, "y": 0.0, "z": 0.0, "yaw": 0.0, **MOVES[case]["root_joint"]}
    turn, across = pin.utils.rotate("z", far["yaw"]), np.diag([1.0, -1.0 if reflected else 1.0, 1.0])
    space = ConfigurationSpace(robot.model, coordinates)
    C, moved = space.affine(image.C, image.moved)
    for _ in range(3):
        q = pin.randomConfiguration(robot.model, -np.ones(robot.nq), np.ones(robot.nq))
        v = rng.normal(size=robot.nv)
        there = image.configuration(q)
        before, after = robot.frame_placement(base, q), robot.frame_placement(base, there)
        offset = np.array([far["x"], far["y"], far["z"]])
        assert np.allclose(after.translation, turn @ across @ before.translation + offset)
        assert np.allclose(after.rotation, turn @ across @ before.rotation @ across)
        legs = slice(robot.configuration_indices(base).stop, None)
        assert np.array_equal(there[legs], q[legs])
        eps = 1e-6
        ends = [image.configuration(robot.integrate(q, side * eps * v)) for side in (-1.0, 1.0)]
        assert np.allclose(robot.difference(*ends) / (2 * eps), image.velocity(v), atol=1e-7)
        z, z_there = space.coordinates(np.array([q, there]))
        between = robot.difference(there, space.configurations((C @ z + moved)[None])[0])
        assert np.abs(between).max() < 1e-12
        assert np.abs(np.abs(C @ z + moved) - np.abs(z_there)).max() < 1e-12  # quaternions but for the sign


TABLES: list[dict[str, Any]] = [
    {"start": {"free": {"q": {"except": ["elbow_joint"]}}}, "goal": {"periodic": True}},
    {"start": {"free": True}, "goal": {"periodic": True}},
    {
        "start": {"free": "q"},
        "goal": {"periodic": {"moved": {"elbow_joint": 0.5}, "except": ["wrist_1_joint"]}},
    },
    {"start": {"free": {"v": {"elbow_joint": [-1, 2], "wrist_1_joint": True}}}, "goal": {"v": 0}},
    {
        "start": {"free": {"q": ["elbow_joint"], "v": True}},
        "goal": {
            "periodic": {
                "swap": [["wrist_1_joint", "wrist_2_joint"]],
                "combine": {"elbow_joint": {"elbow_joint": 1, "wrist_3_joint": -2}},
                "mirror": ["wrist_3_joint"],
                "impact": "tool0",
            }
        },
    },
]


@pytest.mark.parametrize("tables", TABLES)
def test_round_trip(tables: dict[str, Any]) -> None:
    problem = Problem.create("ur5", 1.0, 10, **{"integrator": {"scheme": "se1"}, **tables})
    text = to_toml(tables_of(problem))
    again = problem_from_tables(parse_toml(text))
    assert to_toml(tables_of(again)) == text
    free, same = problem.start_free, again.start_free
    assert free is not None
    assert same is not None
    assert free.directions == same.directions
    assert np.array_equal(free.lower, same.lower)
    assert problem.goal.periodic == again.goal.periodic
    assert Periodic() == Periodic()


REFUSED: list[tuple[str, dict[str, Any], str]] = [
    ("ur5", {"start": {"free": "x"}}, 'start.free: got \'x\', expected true, "q", "v"'),
    ("ur5", {"start": {"free": {"w": True}}}, "start.free: unknown key 'w'"),
    ("ur5", {"start": {"free": {"v": ["elbow"]}}}, "no joint 'elbow'"),
    ("ur5", {"start": {"free": {"v": {"elbow_joint": [1, 0]}}}}, "expected true, or [lower, upper]"),
    ("ur5", {"start": {"free": {"v": {"elbow_joint": [1, 2]}}}}, "is the guess of what start.free sets free"),
    ("ur5", {"start": {"free": {}}}, "nothing is free"),
    ("ur5", {"start": {"free": {"q": {"except": ["elbow"]}}}}, "start.free.q.except: "),
    ("ur5", {"start": {"free": {"q": {"except": "elbow_joint"}}}}, "start.free.q.except: "),
    ("hector", {"start": {"free": {"q": {"root_joint": [0, 1]}}}}, "is no single number"),
    ("ur5", {"start": {"free": True}, "coordinates": "natural"}, 'is for coordinates = "joint"'),
    ("ur5", {"goal": {"periodic": True}, "coordinates": "natural"}, 'is for coordinates = "joint"'),
    ("unicycle_pendulum", {"start": {"free": "v"}, "scheme": "rk4"}, "prescribe velocities"),
    ("unicycle_pendulum", {"goal": {"periodic": True}, "scheme": "rk4"}, "prescribe velocities"),
    ("four_bar", {"start": {"free": {"v": ["crank"]}}}, "cannot keep the constraints"),
    ("ur5", {"goal": {"periodic": True, "v": 0}}, "goal.periodic: says what q and v are at the end"),
    ("ur5", {"goal": {"periodic": True, "enforce": "penalty"}}, 'for enforce = "exact"'),
    ("ur5", {"goal": {"periodic": {"swap": [["elbow_joint"]]}}}, "expected pairs of joints"),
    ("ur5", {"goal": {"periodic": {"mirror": ["elbow"]}}}, "no joint 'elbow'"),
    ("ur5", {"goal": {"periodic": {"turned": 1}}}, "goal.periodic: unknown key 'turned'"),
    ("ur5", {"goal": {"periodic": {"impact": "foot"}}}, "no frame 'foot'"),
    ("ur5", {"goal": {"periodic": {"impact": "base_link"}}}, "cannot be moved"),
    ("hector", {"goal": {"periodic": {"swap": [["root_joint", "root_joint"]]}}}, "is no joint of one number"),
    ("hector", {"goal": {"periodic": {"moved": {"root_joint": 0.3}}}}, "expected a table with x, y, z, yaw"),
    (
        "hector",
        {"goal": {"periodic": {"moved": {"root_joint": {"roll": 0.3}}}}},
        "expected a table with x, y, z, yaw",
    ),
    ("ur5", {"goal": {"periodic": {"moved": {"elbow_joint": {"x": 0.3}}}}}, "a joint of one number"),
    (
        "hector",
        {"goal": {"periodic": {"moved": {"root_joint": {"x": float("nan")}}}}},
        "expected a number",
    ),
    (
        "ur5",
        {"goal": {"periodic": {"moved": {"elbow_joint": 1}, "except": ["elbow_joint"]}}},
        "is in `moved` and in `except`",
    ),
]


@pytest.mark.parametrize(("robot", "words", "message"), REFUSED)
def test_refused_by_name(robot: str, words: dict[str, Any], message: str) -> None:
    spec: Any = {"name": robot, "actuated": ["root_joint"]} if robot == "hector" else robot
    with pytest.raises(MbocpError, match=re.escape(message)):
        Problem.create(spec, 1.0, 10, **words)
