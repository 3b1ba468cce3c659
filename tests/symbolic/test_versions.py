"""A native part that does not fit is an error, never a wrong number."""

from __future__ import annotations

import sys
from contextlib import nullcontext
from pathlib import Path

import pinocchio as pin
import pytest

from mbocp.exceptions import NativeMismatch
from mbocp.symbolic import ModelFunctions, check_versions, model_functions, self_test
from mbocp.symbolic.bridge import _read_installed_version, bridge

if sys.version_info >= (3, 11):
    import tomllib
else:
    import tomli as tomllib

INSTALLED = "mbocp.symbolic.bridge._read_installed_version"
PROJECT = Path(__file__).parents[2] / "pyproject.toml"


def test_what_is_installed_fits():
    check_versions()


@pytest.mark.parametrize("package", ["pin", "libpinocchio", "casadi"])
def test_another_version_names_both_and_the_remedy(package, monkeypatch):
    monkeypatch.setattr(INSTALLED, lambda name: "9.9.9" if name == package else _read_installed_version(name))
    remedy = r"python -m pip install pin==4\.1\.0 libpinocchio==4\.1\.0 casadi==3\.8\.2"
    with pytest.raises(NativeMismatch, match=rf"against {package} \d\S*, but {package} 9\.9\.9.*{remedy}"):
        check_versions()


@pytest.mark.parametrize(("package", "fits"), [("casadi", True), ("pin", False), ("libpinocchio", False)])
def test_another_patch_of_casadi_alone_fits(package, fits, monkeypatch):
    compiled = _read_installed_version(package)
    other = compiled.rpartition(".")[0] + ".99"
    monkeypatch.setattr(INSTALLED, lambda name: other if name == package else _read_installed_version(name))
    with nullcontext() if fits else pytest.raises(NativeMismatch, match=rf"{package} {other}"):
        check_versions()


def test_a_missing_package_is_named(monkeypatch):
    monkeypatch.setattr(INSTALLED, lambda name: None)
    with pytest.raises(NativeMismatch, match="pin is not installed"):
        check_versions()


def test_a_native_part_that_was_not_built_is_named(monkeypatch):
    monkeypatch.setitem(sys.modules, "mbocp._native._versions", None)
    with pytest.raises(NativeMismatch, match=r"not built; run `python -m pip install \.`"):
        check_versions()


def test_no_function_is_built_on_a_mismatch(monkeypatch):
    monkeypatch.setattr(INSTALLED, lambda name: "9.9.9")
    bridge.cache_clear()
    with pytest.raises(NativeMismatch):
        ModelFunctions(pin.buildSampleModelManipulator())


def test_self_test_passes_and_leaves_pinocchios_random_numbers_alone():
    model = pin.buildSampleModelHumanoid()
    pin.seed(7)
    expected = pin.SE3.Random()
    pin.seed(7)
    self_test(model)
    assert pin.SE3.Random() == expected


def test_self_test_reports_wrong_numbers(monkeypatch):
    model = pin.buildSampleModelManipulator()
    heavier = pin.Model(model)
    for inertia in heavier.inertias:
        inertia.mass *= 1.01
    wrong = model_functions(heavier)
    monkeypatch.setattr("mbocp.symbolic.algorithms.model_functions", lambda _: wrong)
    with pytest.raises(NativeMismatch, match=r"joint forces differ by [\d.]+ of [\d.]+"):
        self_test(model)


def test_build_and_run_time_pins_agree():
    project = tomllib.loads(PROJECT.read_text())
    build = {pin for pin in project["build-system"]["requires"] if "==" in pin}
    run = {pin for pin in project["project"]["dependencies"] if "==" in pin}
    elsewhere = {pin for pin in build if pin.startswith(("cmeel-eigen", "casadi"))}
    assert build - elsewhere <= run


def test_the_native_part_is_compiled_against_the_newest_casadi():
    project = tomllib.loads(PROJECT.read_text())
    (built,) = [need for need in project["build-system"]["requires"] if need.startswith("casadi")]
    (run,) = [need for need in project["project"]["dependencies"] if need.startswith("casadi")]
    oldest, newest = run.removeprefix("casadi>=").split(",<=")
    assert built == f"casadi=={newest}"
    assert oldest.split(".")[:2] == newest.split(".")[:2]
