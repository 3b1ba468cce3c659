from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from mbocp.problem import Problem, load_problem
from mbocp.robot import Robot, load_robot

EXAMPLES = Path(__file__).parents[2] / "examples"

ARM = """
robot = "ur5"
[horizon]
duration = 1.0
steps = 20
[start]
q = [0, -1.57, 0, -1.57, 0, 0]
[goal]
q = [0.5, -1.2, 0.5, -0.3, 0.4, 0.2]
v = [0, 0, 0, 0, 0, 0]
enforce = "exact"
[cost]
effort = 1.0
"""


@pytest.fixture(scope="session")
def ur5() -> Robot:
    return load_robot("ur5")


@pytest.fixture(scope="session")
def kinova() -> Robot:
    return load_robot("kinova")


@pytest.fixture(scope="session")
def hector() -> Robot:
    return load_robot("hector", actuated=["root_joint"])


@pytest.fixture(scope="session")
def pendulum() -> Robot:
    return load_robot("rigid_pendulum")


@pytest.fixture
def arm_file(tmp_path: Path) -> Path:
    path = tmp_path / "arm.toml"
    path.write_text(ARM)
    return path


@pytest.fixture
def load(arm_file: Path) -> Callable[..., Problem]:
    """Load the arm's problem file with `--set` strings, or with lines put at its end."""

    def loader(*overrides: str, extra: str = "", replace: tuple[str, str] = ("", "")) -> Problem:
        arm_file.write_text(ARM.replace(*replace) + extra if replace[0] else ARM + extra)
        return load_problem(arm_file, list(overrides))

    return loader


@pytest.fixture
def swing(pendulum: Robot) -> Callable[..., Problem]:
    """Make the spherical pendulum's problem with some tables exchanged."""

    def maker(**tables: Any) -> Problem:
        defaults: dict[str, Any] = {
            "start": {"q": [5, 0, 0], "p": [0, 10, 0]},
            "goal": {"q": [0, 0, -5], "p": [0, 0, 0]},
        }
        words = {"duration": 1.0, "steps": 10} | {
            k: tables.pop(k) for k in ("duration", "steps") if k in tables
        }
        return Problem.create(pendulum, **{"integrator": {"scheme": "se1"}, **words, **defaults, **tables})

    return maker
