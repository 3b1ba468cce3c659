"""Energy that motors draw through gears with losses."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

import mbocp
from mbocp.cli.solution_summary import solution_rows
from mbocp.exceptions import MbocpError
from mbocp.formulation import formulate
from mbocp.problem import Problem, parse_problem, problem_to_toml
from mbocp.solution import loads_of
from tests.formulation.stages import check_derivatives

EXAMPLES = Path(__file__).parents[2] / "examples"
LOSSES, SPEED, DURATION, INERTIA = 0.3, 2.0, 1.5, 0.5
KINETIC = INERTIA * SPEED**2 / 2.0
COPPER = LOSSES * (INERTIA * SPEED) ** 2 / DURATION  # of the constant torque
ROTOR = f"""<robot name="rotor"><link name="base"/>
<link name="wheel"><inertial><mass value="1"/>
<inertia ixx="{INERTIA}" iyy="{INERTIA}" izz="{INERTIA}" ixy="0" ixz="0" iyz="0"/></inertial></link>
<joint name="axle" type="revolute"><parent link="base"/><child link="wheel"/><axis xyz="0 0 1"/>
<limit lower="-100" upper="100" effort="0" velocity="50"/></joint></robot>"""


@pytest.fixture
def rotor(tmp_path: Path) -> mbocp.Robot:
    file = tmp_path / "rotor.urdf"
    file.write_text(ROTOR)
    return mbocp.load_robot(file)


def energy(**words: Any) -> dict[str, Any]:
    return {"effort": 0.0, "energy": {"losses": LOSSES, **words}}


def spin(rotor: mbocp.Robot, begin: float, end: float, **words: Any) -> Problem:
    """From one speed to another one in a given time."""
    words = {"scheme": "midpoint", **words}
    return Problem.create(rotor, DURATION, 30, start={"v": [begin]}, goal={"v": [end]}, **words)


def lift(scheme: str = "midpoint", coordinates: str = "joint", **words: Any) -> Problem:
    goal, kinds = {"q": [0.8, 0.4], "v": 0}, {"scheme": scheme, "coordinates": coordinates}
    return Problem.create("double_pendulum", 1.0, 20, goal=goal, cost=energy(**words), **kinds)


@pytest.mark.parametrize(("efficiency", "regeneration"), [(1.0, 1.0), (0.7, 0.0), (0.7, 0.5), (0.4, 1.0)])
def test_a_wheel_draws_what_its_gear_asks_for(
    rotor: mbocp.Robot, efficiency: float, regeneration: float
) -> None:
    """Up to speed through the gear, and down again: a constant torque loses least in the windings."""
    cost = energy(efficiency=efficiency, regeneration=regeneration, width=1e-4)
    up = mbocp.solve(spin(rotor, 0.0, SPEED, cost=cost), check=True)
    assert up.cost == pytest.approx(COPPER + KINETIC / efficiency, abs=1e-3)
    assert up.drawn_energy == pytest.approx(COPPER + KINETIC / efficiency, rel=1e-6)
    down = mbocp.solve(spin(rotor, SPEED, 0.0, cost=cost), check=True)
    assert down.cost == pytest.approx(COPPER - efficiency * regeneration * KINETIC, abs=1e-3)
    assert down.drawn_energy == pytest.approx(COPPER - efficiency * regeneration * KINETIC, rel=1e-6)
    (load,) = loads_of(up, rotor)
    assert (load.work, load.braked) == pytest.approx((KINETIC, 0.0), rel=1e-9)
    (load,) = loads_of(down, rotor)
    assert (load.work, load.braked) == pytest.approx((0.0, KINETIC), rel=1e-9)


def test_it_is_never_more_than_without_a_width_and_little_less(rotor: mbocp.Robot) -> None:
    for width in (0.01, 0.1, 1.0):
        s = mbocp.solve(spin(rotor, 0.0, SPEED, cost=energy(efficiency=0.7, width=width)), check=True)
        (load,) = loads_of(s, rotor)
        assert s.drawn_energy == pytest.approx(LOSSES * load.rms**2 * DURATION + load.work / 0.7)
        assert 0.0 < s.drawn_energy - s.cost < width * DURATION / (2.0 * 0.7)
    words = f"{s.drawn_energy:.4g} J from the supply, as cost.energy says"
    assert dict(solution_rows(s, ""))["energy"] == words


def test_between_rests_gears_without_losses_cost_windings_alone() -> None:
    """Without friction, and on a level: the work comes back."""
    arm = mbocp.load_problem(EXAMPLES / "arms" / "ur5_reach.toml").with_(scheme="midpoint", steps=30)
    turned = arm.q_start + np.array([0.8, 0.0, 0.0, 0.0, 0.0, 0.0])  # about the vertical axis
    arm = arm.with_(goal={"q": turned, "v": 0})
    plain = mbocp.solve(arm.with_(cost={"effort": 2.0 * LOSSES, "velocity": 0.0}), check=True)
    cost = {**energy(regeneration=1.0), "velocity": 0.0}
    drawn = mbocp.solve(arm.with_(cost=cost), warm_start=plain, check=True)
    assert drawn.cost == pytest.approx(plain.cost, rel=1e-2)
    np.testing.assert_allclose(drawn.us, plain.us, atol=2e-2 * np.abs(plain.us).max())


def test_where_braking_is_burnt_less_is_braked() -> None:
    shares = []
    for regeneration in (1.0, 0.0):
        solution = mbocp.solve(lift(losses=0.01, regeneration=regeneration, width=0.01), check=True)
        loads = loads_of(solution, solution.problem.robot)
        shares.append(sum(load.braked for load in loads))
    assert shares[1] < 0.9 * shares[0]


def test_natural_coordinates_draw_the_same() -> None:
    joint, natural = (
        mbocp.solve(lift(coordinates=kind, efficiency=0.8, width=0.1), check=True)
        for kind in ("joint", "natural")
    )
    assert natural.cost == pytest.approx(joint.cost, rel=2e-2)


@pytest.mark.parametrize("scheme", ["se1", "midpoint", "gauss2", "rk4"])
@pytest.mark.parametrize("regeneration", [0.5, 1.0])
def test_its_derivatives_are_exact(scheme: str, regeneration: float) -> None:
    """Also of gears without losses, where the root is of next to nothing."""
    efficiency = 0.7 if regeneration < 1.0 else 1.0
    problem = lift(scheme, efficiency=efficiency, regeneration=regeneration, width=0.3)
    check_derivatives(formulate(problem), 2, [])


def test_other_motors_compile_nothing_and_files_say_the_same() -> None:
    one, two = lift(), lift(losses=[0.1, 0.2], efficiency=0.7, width=2.0)
    assert formulate(one).pieces.signature == formulate(two).pieces.signature
    again = parse_problem(problem_to_toml(two)).cost
    np.testing.assert_array_equal(again.weight("energy"), two.cost.weight("energy"))
    assert again.weight("energy").tolist() == [[0.7, 0.7], [0.0, 0.0], [0.1, 0.2], [2.0, 2.0]]
    without = two.with_(cost={"energy": None, "effort": 1.0})
    assert "energy" not in problem_to_toml(without)


@pytest.mark.parametrize(
    ("words", "says"),
    [
        ({"efficiency": 1.2}, r"energy\.efficiency\.joint1: got 1\.2, expected above 0 and up to 1"),
        ({"efficiency": [0.5, 0.0]}, r"energy\.efficiency\.joint2: got 0\.0, expected above 0 and up to 1"),
        ({"regeneration": -0.1}, r"energy\.regeneration\.joint1: got -0\.1, expected from 0 to 1"),
        ({"losses": {"joint2": -1.0}}, r"energy\.losses\.joint2: got -1\.0, expected 0 or more"),
        ({"width": 0}, r"energy\.width\.joint1: got 0\.0, expected above 0"),
        ({"losses": [1.0]}, r"energy\.losses: got shape \(1,\), expected \(2,\)"),
        ({"gear": 3}, r"energy.*gear"),
        ({"losses": 0.0}, r"cost\.effort: got 0\.0, expected a positive number: nothing else in the cost"),
    ],
)
def test_what_is_no_motor_is_refused(words: dict[str, Any], says: str) -> None:
    with pytest.raises(MbocpError, match=says):
        lift(**words)


def test_what_has_no_power_is_refused() -> None:
    kinematic = mbocp.load_robot("double_pendulum", dynamics=False)
    with pytest.raises(MbocpError, match=r"cost.energy: the control 'joint1' \[rad/s\^2\] is no force"):
        Problem.create(kinematic, 1.0, 10, goal={"q": [1.0, 0.5]}, cost=energy())
    with pytest.raises(MbocpError, match=r"phase\.0\.cost.*energy"):
        lift().with_(phase=[{"name": "up", "steps": 10, "duration": 0.5, "cost": energy()}])
