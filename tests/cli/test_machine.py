"""`mbocp robots`, `doctor`, `--help`, and how soon they answer."""

from __future__ import annotations

import json
import re
import subprocess
import sys
import time
from importlib.metadata import version
from pathlib import Path

import numpy as np
import pytest

import mbocp
import mbocp.cli.doctor as doctor_module
from mbocp._files import parse_toml

from .conftest import Run

EXAMPLES = Path(__file__).parents[2] / "examples"


def test_robots(run: Run) -> None:
    done = run("robots")
    assert done.exit_code == 0
    for name in ("ur5", "panda", "rigid_pendulum"):
        assert name in done.stdout
    names = [entry["name"] for entry in json.loads(run("robots", "--json").stdout)]
    assert len(names) > 65


@pytest.mark.parametrize(
    ("name", "words"),
    [
        ("ur5", ["shoulder_pan_joint", "revolute", "150", "N m"]),
        ("rigid_pendulum", ["rod", "length 5", "N"]),
        ("hector", ["root_joint", "floating"]),
        ("four_bar", ["1 degree of freedom, with a control", "2 constraints (of 5 rows)", "pin.tilt_1"]),
        ("solo12", ["18 degrees of freedom, with 12 controls: underactuated", "passive   root_joint"]),
    ],
)
def test_robot(run: Run, name: str, words: list[str]) -> None:
    done = run("robots", name)
    assert done.exit_code == 0
    for word in words:
        assert word in done.stdout
    assert json.loads(run("robots", name, "--json").stdout)["name"] == name


def test_unknown_robot(run: Run) -> None:
    done = run("robots", "ur55")
    assert done.exit_code == 2
    assert "did you mean 'ur5'" in done.stderr


def test_the_file_of_a_robot_is_called_by_its_format(run: Run, tmp_path: Path) -> None:
    path = tmp_path / "arm.xml"
    body = '<body name="b"><joint name="j"/><geom size="0.1"/></body>'
    path.write_text(f"<mujoco><worldbody>{body}</worldbody></mujoco>")
    assert re.search(rf"^MJCF +{re.escape(str(path))}$", run("robots", str(path)).stdout, re.MULTILINE)


def test_doctor_says_what_to_do(run: Run, monkeypatch: pytest.MonkeyPatch) -> None:
    def broken() -> tuple[doctor_module.Verdict, str, str]:
        raise ImportError("no such library")

    monkeypatch.setattr(doctor_module, "_CHECKS", {"one": lambda: ("warn", "half", "mend it"), "two": broken})
    done = run("doctor")
    assert done.exit_code == 1
    assert "warn  one  half" in done.stdout
    assert "-> mend it" in done.stdout
    assert "fail  two  ImportError: no such library" in done.stdout
    facts = json.loads(run("doctor", "--json").stdout)
    assert facts["works"] is False


def test_doctor_finds_nothing_broken_here(run: Run) -> None:
    checks = {check.name: check for check in doctor_module.report()}
    assert [check for check in checks.values() if check.verdict == "fail"] == []


def test_doctor_names_what_a_report_of_a_bug_needs() -> None:
    found = {check.name: check.found for check in doctor_module.report()}
    assert f"mbocp {mbocp.__version__}" in found["system"]
    assert f"numpy {np.__version__}" in found["packages"]
    assert "xarray " in found["extras"]
    assert "; instructions " in found["kernel"]
    assert f"{version('pin')}, CasADi {version('casadi')}" in found["native part"]


def test_doctor_knows_the_packages_and_extras_of_the_project() -> None:
    project = parse_toml((EXAMPLES.parent / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    named = {
        extra: re.split(r"[^\w-]", names[0])[0] for extra, names in project["optional-dependencies"].items()
    }
    del named["dev"]
    assert named == doctor_module.EXTRAS
    needed = {re.split(r"[^\w-]", name)[0] for name in project["dependencies"]}
    assert set(doctor_module.PACKAGES) <= needed


def test_version(run: Run) -> None:
    assert run("--version").stdout == f"mbocp {mbocp.__version__}\n"


def test_help_is_quick_and_light() -> None:
    """Half a second is asked for; importing the libraries is what takes long."""
    code = (
        "import sys\nsys.argv = ['mbocp', '--help']\nfrom mbocp.cli import main\n"
        "try:\n    main()\nexcept SystemExit as e:\n    assert not e.code\n"
        "heavy = {'numpy', 'pinocchio', 'casadi', 'matplotlib', 'pydantic', 'h5py'} & set(sys.modules)\n"
        "assert not heavy, heavy\n"
    )
    clock = time.perf_counter()
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    assert time.perf_counter() - clock < 5.0  # [s] with a wide margin for a busy machine
    for command in ("solve", "replay", "plot", "info", "robots", "doctor"):
        assert command in done.stdout
