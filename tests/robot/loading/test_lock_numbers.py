"""What values of locked joints decide are parameters: another value builds nothing."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import mbocp
from mbocp.problem import Problem
from mbocp.robot import Payload, Robot, load_robot, robot_from_spec
from mbocp.robot.loading import locking
from mbocp.symbolic import model_functions
from tests.formulation.test_payload_numbers import baked
from tests.mechanics import mimics
from tests.robot import urdfs

LOCKS = {  # joints, some of them in the middle of a chain, at a floating base, with followers
    "ur5": ("elbow_joint", "wrist_3_joint"),
    "panda": ("panda_finger_joint1", "panda_finger_joint2"),
    "solo12": ("FL_KFE", "HR_HAA"),
    "hand": ("finger1", "knuckle"),
    "double_pendulum": ("joint2",),
}


@pytest.fixture(scope="module")
def sources(tmp_path_factory: pytest.TempPathFactory) -> dict[str, str | Path]:
    hand = urdfs.write(tmp_path_factory.mktemp("hand"), mimics.HAND)
    return {name: hand if name == "hand" else name for name in LOCKS}


def locked(source: str | Path, name: str, values: list[float]) -> Robot:
    return load_robot(source, lock=dict(zip(LOCKS[name], values, strict=False)), **OPTIONS.get(name, {}))


OPTIONS: dict[str, dict] = {"panda": {"payload": [{"frame": "panda_hand", "mass": 0.4, "com": [0, 0, 0.1]}]}}
VALUES = st.lists(st.one_of(st.just(0.0), st.floats(-1.5, 1.5)), min_size=2, max_size=2)


@pytest.mark.parametrize("name", LOCKS)
@given(values=VALUES, seed=st.integers(0, 2**31))
@settings(max_examples=4)
def test_functions_of_all_values(
    name: str, sources: dict[str, str | Path], values: list[float], seed: int
) -> None:
    """They are the same functions, and give what Pinocchio makes of the joints at their values."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(locking, "reduce_by_locks", lambda model, ids, named, reduced, q: (reduced, ()))
        plain = locked(sources[name], name, values)
    robot, other = (locked(sources[name], name, v) for v in (values, [0.3, -0.4]))
    assert robot.shape_fingerprint == other.shape_fingerprint
    assert robot.varying == other.varying
    assert robot.varying
    functions, numbers = model_functions(robot.model, robot.varying), robot.varying_values
    assert functions is model_functions(other.model, other.varying)
    model, rng = plain.model, np.random.default_rng(seed)
    q = pin.integrate(model, pin.neutral(model), rng.uniform(-1, 1, model.nv))
    v, a = rng.standard_normal((2, model.nv))
    wanted = pin.rnea(model, model.createData(), q, v, a)
    size = 1e-11 * (1.0 + np.abs(wanted).max())
    np.testing.assert_allclose(functions.rnea(q, v, a, numbers).full().ravel(), wanted, atol=size)
    mass = plain.mass_matrix(q)
    np.testing.assert_allclose(robot.mass_matrix(q), mass, atol=1e-12 * np.abs(mass).max())
    data = model.createData()
    pin.framesForwardKinematics(model, data, q)
    for frame, here in enumerate(data.oMf):
        R, p = functions.frame_placement(frame)(q, numbers)
        np.testing.assert_allclose(R.full(), here.rotation, atol=1e-12)
        np.testing.assert_allclose(p.full().ravel(), here.translation, atol=1e-12)


@pytest.mark.parametrize("name", LOCKS)
def test_operations(name: str, sources: dict[str, str | Path]) -> None:
    """At a value that is nothing special they are the same but for a few."""
    robot = locked(sources[name], name, [0.37, 0.23])
    own, constant = model_functions(robot.model, robot.varying), model_functions(robot.model)
    assert own.rnea.n_instructions() <= 1.05 * constant.rnea.n_instructions() + 10


def test_what_a_description_locks_stays_a_constant(tmp_path: Path) -> None:
    urdf = urdfs.chain("revolute", "revolute", "revolute")
    path = urdfs.write(tmp_path, urdf, "[lock]\nj2 = 0.3\n")
    robot = load_robot(path)
    assert robot.varying == ()
    assert load_robot(path, lock={"j2": 0.3}).varying
    assert load_robot(path, lock=["j2"]).varying  # at the initial pose


def test_frames_that_are_added_stand_on_those_behind_the_joint() -> None:
    payload = Payload(frame="tool0", mass=1.0, com=(0.0, 0.0, 0.1))
    bare = [load_robot("ur5", lock={"wrist_3_joint": value}) for value in (0.1, 0.2)]
    one, two = (robot.with_payload(payload) for robot in bare)
    assert one.shape_fingerprint == two.shape_fingerprint
    again = robot_from_spec(two.spec)
    assert again.shape_fingerprint == two.shape_fingerprint
    assert again.fingerprint == two.fingerprint
    elsewhere = bare[0].with_payload(Payload(frame="forearm_link", mass=1.0))
    assert elsewhere.shape_fingerprint != one.shape_fingerprint


def test_joints_of_parts() -> None:
    def hands(opening: float, beside: float) -> Robot:
        fingers = {"panda_finger_joint1": opening, "panda_finger_joint2": opening}
        hand = {"name": "left", "robot": "panda", "lock": fingers}
        arm = {"name": "arm", "robot": "ur5", "position": [1, 0, 0]}
        return robot_from_spec({"part": [hand, arm], "lock": {"arm/wrist_3_joint": beside}})

    robots = [hands(0.01, 0.1), hands(0.03, 0.1), hands(0.03, -0.2)]
    assert len({robot.fingerprint for robot in robots}) == 3
    assert len({robot.shape_fingerprint for robot in robots}) == 1


@pytest.mark.parametrize(
    "scheme", ["se1", "euler", *(pytest.param(name, marks=pytest.mark.slow) for name in ("gauss2", "rk4"))]
)
def test_another_value_builds_nothing(scheme: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Of the joint in the middle of a chain; goals speak of a frame behind it."""
    monkeypatch.setenv("MBOCP_CACHE_DIR", str(tmp_path / "cache"))
    path = urdfs.write(tmp_path / "robot", urdfs.chain("revolute", "revolute", "revolute", "revolute"))

    def swing(angle: float, keep: bool = True) -> Problem:
        robot = load_robot(path, lock={"j3": angle})
        place = robot.frame_placement("l4", [0.2, 0.1, 0.1]).translation
        goal = {"frame": {"name": "l4", "position": place}}
        return Problem.create(robot if keep else baked(robot), 0.5, 8, goal=goal, scheme=scheme)

    def built() -> int:
        return len(list((tmp_path / "cache" / "stages").glob("*.tape")))

    first, before = mbocp.solve(swing(0.5)), built()
    second = mbocp.solve(swing(-0.9))
    assert built() == before > 0
    same = mbocp.solve(swing(-0.9, keep=False))
    assert built() > before
    assert all(solution.converged for solution in (first, second, same))
    np.testing.assert_allclose(second.us, same.us, rtol=1e-8, atol=1e-8 * np.abs(same.us).max())
    np.testing.assert_allclose(second.qs, same.qs, atol=1e-9)
    assert abs(second.cost - first.cost) > 1e-3 * first.cost
