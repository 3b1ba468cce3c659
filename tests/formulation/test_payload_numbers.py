"""Inertias of bodies that carry payloads are parameters: another payload builds nothing."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import casadi as ca
import numpy as np
import pinocchio as pin
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import mbocp
from mbocp._files import parse_toml
from mbocp.accuracy.flow import Flow
from mbocp.formulation import formulate, transcribe
from mbocp.problem import Problem
from mbocp.problem.file.tables import problem_to_toml
from mbocp.robot import Payload, Robot, load_robot
from mbocp.study import Study, run_study
from mbocp.symbolic import model_functions
from mbocp.terms import Kinematics, path_constraint, running_cost, terminal_cost
from tests.mechanics import mimics
from tests.robot import urdfs

FILES = 2  # of a shape: the functions of its stages, and those of its end
CARRIERS = {
    "ur5": "tool0",
    "panda": "panda_link5",
    "solo12": "FR_LOWER_LEG",
    "double_pendulum": "link2",
    "hand": "t2",
}


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setenv("MBOCP_CACHE_DIR", str(tmp_path / "cache"))
    return tmp_path / "cache" / "stages"


@pytest.fixture(scope="module")
def bare(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Robot]:
    hand = urdfs.write(tmp_path_factory.mktemp("hand"), mimics.HAND)
    return {name: load_robot(hand if name == "hand" else name) for name in CARRIERS}


def num_files(folder: Path) -> int:
    return len(list(folder.glob("*.tape")))


class Baked(Robot):
    """A robot whose numbers are all constants of its functions."""

    varying = ()


def baked(robot: Robot) -> Robot:
    """The same robot with constants."""
    return Baked(
        **{field.name: getattr(robot, field.name) for field in dataclasses.fields(robot) if field.init}
    )


@st.composite
def payloads(draw: st.DrawFn) -> dict[str, object]:
    """What a body may have: moments of a cloud of points, in any axes."""
    finite = st.floats(-0.3, 0.3, allow_subnormal=False)
    mass = draw(st.floats(0.0, 20.0, allow_subnormal=False))
    points = np.array(draw(st.lists(st.tuples(finite, finite, finite), min_size=4, max_size=4)))
    points -= points.mean(axis=0)
    moments = mass / 4 * (np.trace(points.T @ points) * np.eye(3) - points.T @ points)
    six = [moments[i, j] for i, j in ((0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2))]
    return {"mass": mass, "com": [draw(finite) for _ in range(3)], "inertia": six}


@pytest.mark.parametrize("name", CARRIERS)
@given(table=payloads(), seed=st.integers(0, 2**31))
@settings(max_examples=15)
def test_dynamics_are_those_of_pinocchio(name: str, bare: dict[str, Robot], table: dict, seed: int) -> None:
    robot = bare[name].with_payload(Payload(frame=CARRIERS[name], **table))
    functions = model_functions(robot.model, robot.varying)
    again = model_functions(
        bare[name].with_payload(Payload(frame=CARRIERS[name], mass=1.0)).model, robot.varying
    )
    assert functions is again
    rng, numbers = np.random.default_rng(seed), robot.varying_values
    model, data = robot.model, robot.model.createData()
    q = pin.integrate(model, pin.neutral(model), rng.uniform(-1, 1, model.nv))
    v, a = rng.standard_normal((2, model.nv))
    wanted = pin.rnea(model, data, q, v, a)
    size = 1e-11 * (1.0 + np.abs(wanted).max())
    np.testing.assert_allclose(functions.rnea(q, v, a, numbers).full().ravel(), wanted, atol=size)
    np.testing.assert_allclose(
        functions.crba(q, numbers).full(), robot.mass_matrix(q), atol=1e-11 * (1 + robot.mass_matrix(q).max())
    )
    accelerations = functions.aba(q, v, wanted, numbers).full().ravel()
    np.testing.assert_allclose(
        accelerations, a, atol=1e-8 * (1 + np.abs(a).max()) * np.linalg.cond(robot.mass_matrix(q))
    )
    frame = robot.frame_id("payload")
    _, position = functions.frame_placement(frame)(q, numbers)
    np.testing.assert_allclose(
        position.full().ravel(), robot.frame_placement("payload", q).translation, atol=1e-12
    )


@pytest.mark.parametrize("name", CARRIERS)
def test_operations(name: str, bare: dict[str, Robot]) -> None:
    """Ten numbers more cost a few operations; without a payload there is none."""
    assert bare[name].varying == ()
    assert bare[name].shape_fingerprint == bare[name].fingerprint
    payload = Payload(
        frame=CARRIERS[name], mass=1.0, com=(0.1, 0.2, 0.3), inertia=(0.1, 0.1, 0.1, 0.01, 0.01, 0.01)
    )
    robot = bare[name].with_payload(payload)
    own, constant = model_functions(robot.model, robot.varying), model_functions(robot.model)
    assert own.rnea.n_instructions() <= 1.15 * constant.rnea.n_instructions()


def test_what_varies() -> None:
    arm = load_robot("ur5")
    one, two = (arm.with_payload(Payload(frame="tool0", mass=m, com=(0, 0, m))) for m in (1.0, 2.0))
    assert len(one.varying) == 13
    assert one.shape_fingerprint == two.shape_fingerprint != arm.shape_fingerprint
    assert one.fingerprint != two.fingerprint
    other = arm.with_payload(Payload(frame="forearm_link", mass=1.0))
    assert other.shape_fingerprint != one.shape_fingerprint
    both = one.with_payload(Payload(frame="tool0", mass=1.0, name="more"))
    assert len(both.varying) == 16  # one body, two frames


def reach(payload: dict[str, object], scheme: str, **options: object) -> Problem:
    robot = load_robot("double_pendulum", payload=[{"frame": "link2", **payload}])
    goal = {"q": [0.4, -0.3], "v": [0.0, 0.0]}
    steps = 32 if scheme == "rk4" else 8
    return Problem.create(robot, 1.0, steps, goal=goal, scheme=scheme, **options)


LIGHT = {"mass": 0.2, "com": [0.0, 0.0, 0.1]}
HEAVY = {
    "mass": 1.7,
    "com": [0.03, 0.02, -0.2],
    "inertia": [0.02, 0.03, 0.025, 0.001, -0.002, 0.0005],
    "box": [0.1, 0.2, 0.3],
}


@pytest.mark.parametrize(
    "scheme", ["se1", "midpoint", "gauss2", pytest.param("lobatto3", marks=pytest.mark.slow), "rk4"]
)
def test_another_payload_builds_nothing(scheme: str, folder: Path) -> None:
    first = mbocp.solve(reach(LIGHT, scheme))
    built = num_files(folder)
    assert built >= FILES
    problem = reach(HEAVY, scheme)
    second = mbocp.solve(problem)
    assert num_files(folder) == built
    same = mbocp.solve(problem.with_(robot=baked(problem.robot)))
    assert num_files(folder) > built
    assert all(solution.converged for solution in (first, second, same))
    np.testing.assert_allclose(second.us, same.us, rtol=1e-9, atol=1e-9 * np.abs(same.us).max())
    np.testing.assert_allclose(second.qs, same.qs, atol=1e-10)
    assert abs(second.cost - first.cost) > 0.1 * first.cost


CRATE = {"mass": 1.3, "com": [0.02, -0.03, 0.1], "inertia": [0.02, 0.03, 0.025, 0.001, -0.002, 0.0005]}


def spin(at: Kinematics) -> ca.SX:
    """Looks at what a payload changes, in every way there is."""
    momenta = ca.sumsqr(at.momentum("payload_0")) + ca.sumsqr(at.centroidal_momentum())
    return momenta + at.kinetic_energy() + at.potential_energy() + at.centre_of_mass()[2] + ca.sumsqr(at.a)


def climb(at: Kinematics) -> ca.SX:
    return at.position("payload_0")[2] + at.kinetic_energy()


def looped(scheme: str) -> Problem:
    robot = load_robot("four_bar", payload=[{"frame": "coupler", **CRATE}])
    return Problem.create(robot, 0.5, 6, goal={"v": 0}, scheme=scheme)


def flying(scheme: str, **options: object) -> Problem:
    rotations = "dcm" if scheme == "rk4" else "quaternion"
    payload = [{"frame": "base_link", **CRATE}]
    robot = load_robot("hector", actuated=["root_joint"], rotations=rotations, payload=payload)
    return Problem.create(robot, 0.5, 6, goal={"v": 0}, scheme=scheme, **options)


def arm(**options: object) -> Problem:
    robot = load_robot("ur5", payload=[{"frame": "tool0", "box": [0.1, 0.1, 0.2], **CRATE}])
    near = {"frame": {"name": "payload_0", "position": [0.4, 0.3, 0.4]}}
    return Problem.create(robot, 0.5, 6, **{"goal": near, "scheme": "se1", **options})


def hybrid() -> Problem:
    robot = load_robot("unicycle_pendulum", payload=[{"frame": "pendulum_com", **CRATE}])
    return Problem.create(robot, 0.5, 6, goal={"v": 0}, scheme="rk4")


LEVEL = {"kind": "orientation", "frame": "payload_0", "direction": [0, 0, 1], "max": 2.0}
BALL = {"name": "ball", "shape": "sphere", "radius": 0.1, "position": [0.5, 0.5, 0.5]}
ABOVE = path_constraint(climb, lower=-10.0)
KINDS = {
    "loop": lambda: looped("se1"),
    "loop in stages": lambda: looped("lobatto3"),
    "loop explicit": lambda: looped("rk4"),
    "rotation matrices": lambda: flying("rk4"),
    "groups": lambda: flying("midpoint"),
    "drives": hybrid,
    "frames": lambda: arm(path=[LEVEL]),
    "obstacles": lambda: arm(obstacle=[BALL]),
    "own terms": lambda: arm(terms=[running_cost(spin), terminal_cost(climb, name="end"), ABOVE]),
    "held": lambda: arm(scheme="gauss2", goal={"v": 0}),
}


QUICK = ("loop", "loop explicit", "frames")
STAGE = dict.fromkeys(KINDS, ("values", "complete"))
STAGE |= dict.fromkeys(("frames", "obstacles", "own terms"), ("values", "complete", "path", "path_values"))


@pytest.mark.parametrize(
    "kind", [pytest.param(k, marks=[] if k in QUICK else pytest.mark.slow) for k in KINDS]
)
def test_functions_are_those_with_constants(kind: str) -> None:
    """Stages, path and end at seeded arguments; the numbers are the last of their parameters."""
    problem = KINDS[kind]()
    own, constant = transcribe(problem), transcribe(problem.with_(robot=baked(problem.robot)))
    numbers, rng = problem.robot.varying_values, np.random.default_rng(0)
    np.testing.assert_array_equal(own.theta, np.append(constant.theta, numbers))
    np.testing.assert_array_equal(own.rho_terminal, np.append(constant.rho_terminal, numbers))
    stage, end = (own.functions, constant.functions), (own.end_functions, constant.end_functions)
    pairs = [
        (which, stage) for which in ("values", "complete", "path", "path_values") if which in STAGE[kind]
    ]
    for which, (ours, theirs) in [*pairs, ("terminal_complete", end)]:
        f, g = ours.function(which), theirs.function(which)
        given = [0.5 + 0.3 * rng.standard_normal(g.numel_in(i)) for i in range(g.n_in())]
        if which != "terminal_complete":  # that of obstacles has indices
            given[-1 if which.startswith("path") else -2] = constant.theta
        longer = [np.append(x, numbers) if f.numel_in(i) > x.size else x for i, x in enumerate(given)]
        assert sum(f.numel_in(i) for i in range(f.n_in())) == sum(x.size for x in longer)
        for a, b in zip(f.call(longer), g.call(given), strict=True):
            np.testing.assert_allclose(
                a.full(), b.full(), rtol=1e-9, atol=1e-9 * (1 + np.abs(b.full()).max(initial=0))
            )


def test_natural_coordinates_keep_constants() -> None:
    problem = reach(HEAVY, "se1", coordinates="natural")
    light = reach(LIGHT, "se1", coordinates="natural")
    own, other = formulate(problem).pieces.signature, formulate(light).pieces.signature
    assert own.num_numbers == 0
    assert own.stage_text != other.stage_text
    joint = [formulate(reach(p, "se1")).pieces.signature for p in (HEAVY, LIGHT)]
    assert joint[0].stage_text == joint[1].stage_text
    assert joint[0].end_text == joint[1].end_text


def test_bodies_that_are_picked_up(folder: Path) -> None:
    """A part that is a simple body: another mass, and another one of the cup, build nothing."""

    def carry(box: float, cup: float) -> Problem:
        chain = {"name": "arm", "robot": "chain_3", "payload": [{"frame": "tip", "name": "cup", "mass": cup}]}
        body = {"name": "box", "box": [0.2, 0.1, 0.05], "mass": box}
        hold = [{"name": "grip", "frame": "box/body", "to": "arm/tip"}]
        phases = [{"name": "take", "steps": 3, "duration": 0.2}]
        phases.append({"name": "carry", "steps": 3, "duration": 0.2, "hold": hold})
        return Problem.create({"part": [chain, body]}, phase=phases, goal={"v": 0}, scheme="se1")

    transcribe(carry(1.5, 0.2))
    built = num_files(folder)
    assert built >= FILES
    second = carry(2.5, 0.4)
    programme = transcribe(second)
    assert num_files(folder) == built
    assert 2.5 in programme.theta
    assert len(second.robot.varying) == 2 * 10 + 3


def test_flows_share_their_functions(folder: Path) -> None:
    robots = [reach(p, "se1").robot for p in (LIGHT, HEAVY)]
    flows = [Flow.of(robot) for robot in robots]
    built = num_files(folder)
    flows.append(Flow.of(baked(robots[1])))
    assert num_files(folder) == built + 1
    rng = np.random.default_rng(0)
    qs, vs, us = rng.standard_normal((3, 5, 2))
    light, heavy, constant = (np.hstack(flow.ends(qs, vs, us, np.full(5, 0.1), 4)) for flow in flows)
    np.testing.assert_allclose(heavy, constant, atol=1e-12)
    assert np.abs(heavy - light).max() > 1e-2
    np.testing.assert_allclose(flows[1].energies(qs, vs), flows[2].energies(qs, vs), rtol=1e-12)


def test_a_study_of_payloads_builds_once(folder: Path, tmp_path: Path) -> None:
    problem = reach(LIGHT, "se1")
    tables = {"problem": parse_toml(problem_to_toml(problem))}
    built = []
    for masses in ([0.1], [0.5, 1.0, 1.5]):
        study = Study.from_tables({**tables, "grid": {"robot.payload.0.mass": masses}})
        table = run_study(study, tmp_path / f"{len(masses)}.jsonl", workers=1)
        assert [row["status"] for row in table.rows] == ["converged"] * len(masses)
        assert len({row["cost"] for row in table.rows}) == len(masses)
        built.append(num_files(folder))
    assert built[0] == built[1] > 0
