"""Holds with free starts and periodic motions: cycles that are known, what a start keeps, what is refused."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path
from typing import Any

import casadi as ca
import numpy as np
import pytest
from scipy.optimize import brentq
from scipy.special import ellipk

import mbocp
from mbocp import Problem, Solution
from mbocp._arrays import Array
from mbocp.exceptions import ProblemError
from mbocp.formulation import formulate
from mbocp.problem.timeline.hold import Hold
from tests.holds.cases import drone, four_bar, pendulum

POINT = '<inertial>{}<mass value="{}"/><inertia ixx="0" iyy="0" izz="0" ixy="0" ixz="0" iyz="0"/></inertial>'
LINK = '<link name="{}">{}</link>'
JOINT = """<joint name="{}" type="{}"><parent link="{}"/><child link="{}"/><axis xyz="{}"/>
<limit lower="-9" upper="9" effort="99" velocity="99"/></joint>"""
CART = [
    LINK.format("ground", ""),
    LINK.format("cart", POINT.format("", 3)),
    LINK.format("bob", POINT.format('<origin xyz="0 0 -1"/>', 1)),
    JOINT.format("slide", "prismatic", "ground", "cart", "1 0 0"),
    JOINT.format("hinge", "revolute", "cart", "bob", "0 1 0"),
]
HAND, BOX = 2.0, 1.0  # [kg]
PICKER = [
    LINK.format("ground", ""),
    LINK.format("hand", POINT.format("", HAND)),
    LINK.format("box", POINT.format("", BOX)),
    JOINT.format("arm", "prismatic", "ground", "hand", "1 0 0"),
    JOINT.format("box", "prismatic", "ground", "box", "1 0 0"),
]


@pytest.fixture(scope="module")
def robots(tmp_path_factory: pytest.TempPathFactory) -> dict[str, str]:
    """A pendulum of 1 m on a cart, and a hand with a box on one line."""
    folder = tmp_path_factory.mktemp("robots")
    for name, parts in {"cart": CART, "picker": PICKER}.items():
        (folder / f"{name}.urdf").write_text(f'<robot name="{name}">{"".join(parts)}</robot>')
    return {name: str(folder / f"{name}.urdf") for name in ("cart", "picker")}


def solved(problem: Problem, method: str = "monolithic", **how: Any) -> Solution:
    return mbocp.solve(problem.with_(solver={"method": method}), check=True, **how)


def braked(robot: str, steps: int = 40, hold: dict[str, Any] | None = None, **words: Any) -> Problem:
    """A pendulum whose cart is held swings to and fro in 2.5 s."""
    swing = {
        "name": "swing",
        "steps": steps,
        "duration": 2.5,
        "hold": [hold or {"frame": "cart", "name": "brake"}],
    }
    start = {"q": [0.3, 1.7], "free": {"q": ["hinge"]}}
    told = {"start": start, "goal": {"periodic": True}, "guess": {"u": [0.0, 0.0]}, "scheme": "midpoint"}
    return Problem.create(
        robot, phase=[swing], cost={"effort": 1.0}, **{"integrator": {"scheme": "se1"}, **told, **words}
    )


@pytest.mark.parametrize("method", ["monolithic", "ipopt"])
def test_a_held_cart_is_a_pendulum(robots: dict[str, str], method: str) -> None:
    """A free oscillation; its amplitude is that of the elliptic integral, to dt^2."""
    known = brentq(lambda a: 4 * np.sqrt(1 / 9.81) * ellipk(np.sin(a / 2) ** 2) - 2.5, 0.1, 3.0)
    errors = []
    for steps in (40, 80):
        s = solved(braked(robots["cart"], steps), method)
        assert s.cost < 1e-20
        assert s.constraint_violation < 1e-12
        assert s.velocity_violation < 1e-12
        assert np.abs(s.qs[-1] - s.qs[0]).max() < 1e-12
        assert np.abs(s.vs[-1] - s.vs[0]).max() < 1e-12
        errors.append(s.qs[0, 1] - known)
    assert errors[0] / errors[1] == pytest.approx(4.0, abs=0.1)
    assert abs(errors[1]) < 1e-3


GO, CARRY, BACK, DT = 6, 8, 6, 0.1


def pick_cycle(robot: str, **words: Any) -> Problem:
    """A hand takes a box at 0, which stops it in part, leaves it at 1, and comes back to where it began."""
    ground, grip = {"name": "ground", "frame": "box"}, {"name": "grip", "frame": "box", "to": "hand"}
    steps = {"go": (GO, ground, 0.0), "carry": (CARRY, grip, 1.0), "back": (BACK, ground, None)}
    phases = []
    for name, (count, hold, place) in steps.items():
        via = {} if place is None else {"via": [{"q": {"arm": place}}]}
        phases.append({"name": name, "steps": count, "duration": DT * count, "hold": [hold], **via})
    start = {"q": [0.5, 0.0], "free": {"v": ["arm"]}}
    told = {"start": start, "goal": {"periodic": {"except": ["box"]}}, "scheme": "midpoint", **words}
    return Problem.create(
        {"name": robot, "actuated": ["arm"]},
        phase=phases,
        cost={"effort": 1.0},
        **{"integrator": {"scheme": "se1"}, **told},
    )


def least_effort() -> tuple[float, Array]:
    """Start velocity and controls of that cycle, as one system of linear equations."""
    count = GO + CARRY + BACK
    q, v = np.zeros(count + 2), np.eye(count + 2)[0]  # by v_0, controls and 1
    q[-1] = 0.5
    q0, v0, rows = q, v, []
    for step in range(count):
        carries = GO <= step < GO + CARRY
        if step == GO:
            rows.append(q)
            v = v * HAND / (HAND + BOX)
        if step == GO + CARRY:
            rows.append(q - np.eye(count + 2)[-1])
        ahead = v + np.eye(count + 2)[1 + step] * DT / (HAND + BOX * carries)
        q, v = q + DT * (v + ahead) / 2, ahead
    G = np.array([*rows, q - q0, v - v0])
    H = np.diag([0.0, *np.ones(count)])
    matrix = np.block([[H, G[:, :-1].T], [G[:, :-1], np.zeros((4, 4))]])
    found = np.linalg.solve(matrix, np.concatenate([np.zeros(count + 1), -G[:, -1]]))
    return float(found[0]), found[1 : count + 1]


@pytest.mark.parametrize("method", ["monolithic", "ipopt"])
def test_a_pick_cycle_is_that_of_linear_algebra(robots: dict[str, str], method: str) -> None:
    problem, (rate, controls) = pick_cycle(robots["picker"]), least_effort()
    take, leave = GO + 1, GO + CARRY + 3  # the impacts, each after a parting
    assert problem.impacts == (take - 1, take, leave - 1, leave)
    s = solved(problem, method)
    timed = np.diff(s.t) > 0.0
    assert s.vs[0, 0] == pytest.approx(rate, abs=1e-7)
    assert np.abs(s.us[timed, 0] - controls).max() < 1e-6
    assert np.abs(s.qs[-1] - [0.5, 1.0]).max() < 1e-9
    assert np.abs(s.vs[-1] - s.vs[0]).max() < 1e-9
    assert s.constraint_violation < 1e-12
    assert s.velocity_violation < 1e-12
    assert np.abs(s.vs[take + 1] - s.vs[take, 0] * HAND / (HAND + BOX)).max() < 1e-12  # momentum is kept
    assert abs(s.vs[leave + 1, 0] - s.vs[leave, 0]) < 1e-12  # what stops is the box
    assert s.vs[leave + 1, 1] == pytest.approx(0.0, abs=1e-12)


def walk(steps: int, **words: Any) -> Problem:
    """The compass gait with phases: swinging on one foot, and 50 ms on the other one that has landed."""
    angle, rate = -0.221, 0.914
    foot = {"name": "new foot", "frame": "swinging_foot", "kind": "line", "axis": [0, 1, 0]}
    free = {"min": 0.6, "max": 0.8, "guess": 0.684}
    start = {
        "q": [np.sin(angle), np.cos(angle), angle, 0.496],
        "v": [rate * np.cos(angle), -rate * np.sin(angle), rate, -1.112],
        "free": True,
    }
    legs = {"standing": {"standing": 1, "hip": 1}, "hip": {"hip": -1}}
    told = {
        "phase": [
            {"name": "swing", "steps": steps, "duration": free},
            {"name": "landed", "steps": steps // 14, "duration": 0.05, "release": ["foot"], "hold": [foot]},
        ],
        "start": start,
        "goal": {"periodic": {"combine": legs, "except": ["x"]}},
        "cost": {"effort": 1.0},
        "guess": {"u": [0.0]},
        "scheme": "midpoint",
    }
    robot = {"name": "compass_gait", "gravity": [0.5134157307, 0, -9.7965557359]}
    return Problem.create(robot, **{"integrator": {"scheme": "se1"}, **told, **words})


def test_walking_is_periodic_with_an_impact_within() -> None:
    """Period and legs at the impact converge to those of the return map, see `test_periodic`."""
    problems = [walk(n) for n in (42, 84)]
    found = [solved(problem) for problem in problems]
    errors = []
    for problem, s in zip(problems, found, strict=True):
        robot, step = problem.robot, problem.impacts[-1]
        assert s.cost < 1e-18
        assert s.constraint_violation < 1e-12
        periodic = problem.goal.periodic
        assert periodic is not None
        table = problem.timeline.switches
        assert table is not None
        defect = periodic.defect(robot, (s.qs[0], s.vs[0]), (s.qs[-1], s.vs[-1]))
        along = np.linalg.svd(table.jacobians(problem.goal.q[None])[0])[2][2:]
        assert np.abs(defect[: robot.nv]).max() < 1e-9
        assert np.abs(along @ defect[robot.nv :]).max() < 1e-9
        assert np.abs(defect).max() < 1e-3  # velocities that a hold decides are those of the scheme
        q = s.qs[step]
        foot = robot.frame_placement("swinging_foot", q).translation
        assert abs(foot[2]) < 1e-9
        # Momenta about the foot that lands are kept: the impulse acts there alone.
        J = table.jacobians(q[None])[0]
        leap = robot.mass_matrix(q) @ (s.vs[step + 1] - s.vs[step])
        pushed = np.linalg.lstsq(J.T, leap, rcond=None)[0]
        assert np.abs(J.T @ pushed - leap).max() < 1e-12 * np.abs(leap).max()
        assert np.abs(J @ s.vs[step + 1]).max() < 1e-12
        legs = [-(q[2] + q[3]) - np.radians(3), -q[2] - np.radians(3)]
        errors.append(np.array([s.duration - 0.7343, legs[0] - 0.2187, legs[1] + 0.3234]))
    assert np.abs(errors[1]).max() < 2e-4
    limit = (4 * found[1].duration - found[0].duration) / 3
    assert limit == pytest.approx(0.7343, abs=5e-5)
    other = solved(problems[0], "ipopt", warm_start=found[0])
    assert np.abs(other.qs - found[0].qs).max() < 1e-6
    assert other.duration == pytest.approx(found[0].duration, abs=1e-7)


def held_from_the_start(scheme: str, **fields: Any) -> Problem:
    """The tip of a double pendulum is on a vertical line for four steps; its first velocity is free."""
    hold = replace(pendulum().holds[0], spans=((0, 4),))
    made = pendulum(scheme, steps=10, holds=(hold,), impacts=())
    return made.with_(start={"free": "v"}, cost={"effort": 1.0, "velocity": 0.1}, **fields)


@pytest.mark.parametrize("scheme", ["se1", "midpoint"])
def test_a_free_start_keeps_what_is_held(scheme: str) -> None:
    """The adjoint of the velocity vanishes along what the hold leaves, and the start is the best one."""
    problem = held_from_the_start(scheme)
    own, other = solved(problem), solved(problem, "ipopt")
    table, robot = problem.timeline.switches, problem.robot
    assert table is not None
    J = table.jacobians(own.qs[:1])[0][table.rows[0]]
    assert np.abs(own.vs[0]).max() > 0.1
    assert np.abs(J @ own.vs[0]).max() < 1e-9
    assert own.constraint_violation < 1e-9
    along = np.linalg.svd(J)[2][len(J) :]
    costate = robot.mass_matrix(own.qs[0]) @ own.mus[0][robot.nv :]
    assert np.abs(along @ costate).max() < 1e-8
    if scheme == "midpoint":  # by SE1 an impulse takes out what the hold does not allow, for nothing
        assert np.abs(costate).max() > 1e-6
    assert np.abs(other.qs - own.qs).max() < 1e-6
    given = problem.with_(start={"v": own.vs[0], "free": None})
    assert solved(given, warm_start=own).cost == pytest.approx(own.cost, rel=1e-9)
    assert own.cost < solved(problem.with_(start={"free": None})).cost


def test_a_free_start_is_where_frames_coincide() -> None:
    """The tip begins in a plane through the origin, wherever in it, and at rest, which keeps its rate."""
    wall = Hold(name="wall", frame="tip", kind="plane", axis=(0.0, 1.0, 0.0), at="coincide", spans=((0, 4),))
    q = np.array([0.0, 0.0])
    problem = pendulum(steps=10, holds=(wall,), impacts=(), q_start=q, cost={"effort": 1.0})
    free, given = (solved(problem.with_(start={"free": kind})) for kind in ("q", None))
    table = problem.timeline.switches
    assert table is not None
    assert np.abs(free.qs[0]).max() > 1e-2
    assert np.abs(table.residuals(free.qs[:5], free.qs[:5])).max() < 1e-9
    assert free.cost < given.cost
    assert np.abs(solved(problem.with_(start={"free": "q"}), "ipopt").qs - free.qs).max() < 1e-6


def test_symmetries_are_kept_from_a_free_start() -> None:
    problem = drone("midpoint").with_(start={"free": "v"}, cost={"effort": 1.0, "velocity": 0.1})
    s = solved(problem)
    assert len(s.conserved) == 4
    left = s.history[-1].residual  # round-off of large multipliers
    assert left < 1e-11
    assert np.ptp(s.control_momenta, axis=0).max() < 1e-12 * np.abs(s.control_momenta).max() + left


def test_derivatives_of_the_conditions(robots: dict[str, str]) -> None:
    """Of cycles and of constraints at the start, against differences."""
    wall = Hold(name="wall", frame="tip", kind="hinge", axis=(1.0, 0.0, 0.0), at="coincide", spans=((0, 4),))
    q = np.array([0.0, 0.0])
    above = pendulum(steps=10, holds=(), impacts=(), q_start=q).robot.frame_placement("tip", q).translation
    assert abs(above[1]) < 1e-12
    plane = replace(wall, kind="plane", axis=(0.0, 1.0, 0.0))
    made = pendulum(steps=10, holds=(plane,), impacts=(), q_start=q, v_start=np.zeros(2))
    problems = [
        made.with_(start={"free": True}),
        pick_cycle(robots["picker"]),
        walk(14),
    ]
    for problem in problems:
        programme = formulate(problem).programme
        end, rng = programme.end_functions.function("terminal_complete"), np.random.default_rng(0)
        kind, step = programme.kind, 1e-6
        x = np.asarray(programme.x_start) + 0.2 * rng.standard_normal(kind.nx)
        eta = rng.standard_normal(programme.ng)
        found = [np.asarray(ca.DM(out)) for out in end(x, eta, programme.rho_terminal)]
        curvature = np.triu(found[4]) + np.triu(found[4], 1).T
        for _ in range(4):
            d = rng.standard_normal(kind.nx)
            ahead, back = (
                [np.asarray(ca.DM(out)) for out in end(x + way * step * d, eta, programme.rho_terminal)]
                for way in (1, -1)
            )
            slope = (ahead[1] - back[1]).ravel() / (2 * step)
            scale = 1.0 + np.abs(found[2]).max() + np.abs(curvature).max()
            assert np.allclose(found[2] @ d, slope, atol=1e-7 * scale)
            turned = (ahead[2] - back[2]).T @ eta / (2 * step)
            assert np.allclose(curvature @ d, turned, atol=1e-6 * scale)


def test_a_start_that_moves_before_an_impact_is_no_start() -> None:
    hold = replace(pendulum().holds[0], spans=((0, 4),))
    with pytest.raises(ProblemError, match=r"start\.free: the first step is an impact"):
        pendulum(holds=(hold,), impacts=(0,)).with_(start={"free": "v"})


def test_what_is_free_has_to_keep_what_is_held() -> None:
    hold = Hold(name="grip", frame="tip", kind="point", spans=((0, 4),))
    made = pendulum(steps=10, holds=(hold,), impacts=())
    with pytest.raises(ProblemError, match=r"start\.free\.v: .* cannot keep what is held from the start"):
        made.with_(start={"free": {"v": [made.robot.joint_names[0]]}})


REFUSED: list[tuple[dict[str, Any], str]] = [
    ({"goal": {"periodic": {"impact": "bob"}}}, "goal.periodic.impact: lets go all that is held"),
    ({"goal": {"periodic": {"moved": {"slide": 1.0}}}}, "the symmetry does not leave it where it is"),
    ({"coordinates": "natural"}, 'is for coordinates = "joint"'),
]


@pytest.mark.parametrize(("words", "message"), REFUSED)
def test_cycles_that_cannot_be(robots: dict[str, str], words: dict[str, Any], message: str) -> None:
    with pytest.raises(ProblemError, match=re.escape(message)):
        braked(robots["cart"], **words)


def test_nothing_is_let_go_where_a_cycle_closes(robots: dict[str, str]) -> None:
    hold = Hold(name="brake", frame="cart", spans=((4, 40),))
    with pytest.raises(ProblemError, match=r"'brake\.x' acts at the end and nothing like it at the start"):
        braked(robots["cart"]).with_(phase=(), holds=(hold,), impacts=(4,))
    parted = braked(robots["cart"]).with_(phase=(), holds=(hold,), impacts=(4, 39))
    s = solved(parted)
    assert np.abs(s.vs[-1] - s.vs[0]).max() < 1e-9
    assert np.abs(s.vs[5:, 0]).max() < 1e-9


def test_files_say_it_again(tmp_path: Path) -> None:
    from mbocp.problem import parse_problem, problem_to_toml

    text = problem_to_toml(walk(14))
    assert problem_to_toml(parse_problem(text)) == text


def test_loops_that_open_have_a_free_start() -> None:
    """A four-bar whose loop is open at the end: the start keeps it."""
    problem = four_bar("midpoint", holds=(), impacts=()).with_(start={"free": "v"})
    s = solved(problem)
    assert np.abs(problem.robot.constraint_jacobian(s.qs[0]) @ s.vs[0]).max() < 1e-9
    assert np.abs(s.vs[0]).max() > 1e-3
