"""Inertias of bodies that carry payloads are parameters: another payload compiles nothing, and changes what it must."""

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
from mbocp.accuracy.flow import Flow
from mbocp.formulation import transcribe
from mbocp.mechanics import JointMechanics, symbols_of
from mbocp.mechanics.forward import ForwardMechanics
from mbocp.problem import Problem
from mbocp.programme.compiler import compiler
from mbocp.robot import Payload, Robot, load_robot
from mbocp.symbolic import model_functions
from tests.mechanics import mimics
from tests.robot import urdfs

needs_compiler = pytest.mark.skipif(compiler() is None, reason="no C compiler")
LIBRARIES = 2  # of a shape: the functions of its stages, and those of its end
CARRIERS = {"ur5": "tool0", "panda": "panda_link5", "solo12": "FR_LOWER_LEG", "double_pendulum": "link2", "hand": "t2"}


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setenv("MBOCP_CACHE_DIR", str(tmp_path / "cache"))
    return tmp_path / "cache" / "stages"


@pytest.fixture(scope="module")
def bare(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Robot]:
    hand = urdfs.write(tmp_path_factory.mktemp("hand"), mimics.HAND)
    return {name: load_robot(hand if name == "hand" else name) for name in CARRIERS}


def num_libraries(folder: Path) -> int:
    return len(list(folder.glob("*.so")))


def baked(robot: Robot) -> Robot:
    """The same robot, whose numbers are all constants of its functions."""
    return dataclasses.replace(robot, payloads=(), parts=())


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
@settings(max_examples=15, deadline=None)
def test_dynamics_are_those_of_pinocchio(name: str, bare: dict[str, Robot], table: dict, seed: int) -> None:
    robot = bare[name].with_payload(Payload(frame=CARRIERS[name], **table))
    functions = model_functions(robot.model, robot.varying)
    again = model_functions(bare[name].with_payload(Payload(frame=CARRIERS[name], mass=1.0)).model, robot.varying)
    assert functions is again
    rng, numbers = np.random.default_rng(seed), robot.varying_values
    model, data = robot.model, robot.model.createData()
    q = pin.integrate(model, pin.neutral(model), rng.uniform(-1, 1, model.nv))
    v, a = rng.standard_normal((2, model.nv))
    wanted = pin.rnea(model, data, q, v, a)
    size = 1e-11 * (1.0 + np.abs(wanted).max())
    np.testing.assert_allclose(functions.rnea(q, v, a, numbers).full().ravel(), wanted, atol=size)
    np.testing.assert_allclose(functions.crba(q, numbers).full(), robot.mass_matrix(q), atol=1e-11 * (1 + robot.mass_matrix(q).max()))
    accelerations = functions.aba(q, v, wanted, numbers).full().ravel()
    np.testing.assert_allclose(accelerations, a, atol=1e-8 * (1 + np.abs(a).max()) * np.linalg.cond(robot.mass_matrix(q)))
    frame = robot.frame_id("payload")
    _, position = functions.frame_placement(frame)(q, numbers)
    np.testing.assert_allclose(position.full().ravel(), robot.frame_placement("payload", q).translation, atol=1e-12)


@pytest.mark.parametrize("name", CARRIERS)
def test_operations(name: str, bare: dict[str, Robot]) -> None:
    """Ten numbers more cost a few operations; without a payload there is none."""
    assert bare[name].varying == ()
    assert bare[name].shape_fingerprint == bare[name].fingerprint
    payload = Payload(frame=CARRIERS[name], mass=1.0, com=(0.1, 0.2, 0.3), inertia=(0.1, 0.1, 0.1, 0.01, 0.01, 0.01))
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
    return Problem.create(robot, 1.0, 8, goal=goal, scheme=scheme, **options)


LIGHT = {"mass": 0.2, "com": [0.0, 0.0, 0.1]}
HEAVY = {"mass": 1.7, "com": [0.03, 0.02, -0.2], "inertia": [0.02, 0.03, 0.025, 0.001, -0.002, 0.0005], "box": [0.1, 0.2, 0.3]}


@needs_compiler
@pytest.mark.parametrize("scheme", ["se1", "midpoint", "gauss2", "lobatto3", "rk4"])
def test_another_payload_compiles_nothing(scheme: str, folder: Path) -> None:
    first = mbocp.solve(reach(LIGHT, scheme))
    assert num_libraries(folder) == LIBRARIES
    problem = reach(HEAVY, scheme)
    second = mbocp.solve(problem)
    assert num_libraries(folder) == LIBRARIES
    same = mbocp.solve(problem.with_(robot=baked(problem.robot)))
    assert num_libraries(folder) == 2 * LIBRARIES
    assert first.converged and second.converged and same.converged
    np.testing.assert_allclose(second.us, same.us, rtol=1e-9, atol=1e-9 * np.abs(same.us).max())
    np.testing.assert_allclose(second.qs, same.qs, atol=1e-10)
    assert abs(second.cost - first.cost) > 0.1 * first.cost
