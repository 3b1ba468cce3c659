"""What hosts and tools read beside the code: workflows, forms of issues, the citation."""

from __future__ import annotations

import re
from email import message_from_string
from importlib.metadata import distribution
from pathlib import Path
from typing import Any

import pytest
import yaml

import mbocp
from mbocp._files import parse_toml

ROOT = Path(__file__).parent.parent
FILES = sorted([*ROOT.glob(".github/**/*.yml"), ROOT / "CITATION.cff", ROOT / "conda" / "recipe.yaml"])
FORMS = [path for path in FILES if path.parent.name == "ISSUE_TEMPLATE" and path.name != "config.yml"]
PYTHONS = ["3.10", "3.11", "3.12", "3.13", "3.14"]
CONDA_NAMES = {
    "pin": "pinocchio-python",
    "coal": "coal-python",
    "matplotlib": "matplotlib-base",
    "meshcat": "meshcat-python",
    "cmeel-boost": "libboost-devel",
    "cmeel-eigen": "eigen",
}


def text(name: str) -> str:
    return (ROOT / name).read_text(encoding="utf-8")


def project() -> dict[str, Any]:
    return parse_toml(text("pyproject.toml"))


@pytest.mark.parametrize("file", FILES, ids=lambda path: path.name)
def test_files_are_yaml(file: Path) -> None:
    assert isinstance(yaml.safe_load(file.read_text(encoding="utf-8")), dict)


@pytest.mark.parametrize("form", FORMS, ids=lambda path: path.name)
def test_forms_ask_for_something(form: Path) -> None:
    said = yaml.safe_load(form.read_text(encoding="utf-8"))
    assert said["name"]
    assert said["description"]
    names = [entry["id"] for entry in said["body"] if entry["type"] != "markdown"]
    assert len(set(names)) == len(names) > 0
    for page in re.findall(r"docs/\w+\.md", form.read_text(encoding="utf-8")):
        assert (ROOT / page).exists()


def test_all_files_have_this_version() -> None:
    version = mbocp.__version__
    assert parse_toml(text("papers/pyproject.toml"))["project"]["version"] == version
    assert f"<version>{version}</version>" in text("ros/package.xml")
    assert f"\nversion = {version}\n" in text("ros/setup.cfg")
    assert re.findall(r"^## (.*)$", text("CHANGELOG.md"), re.MULTILINE)[0] in (version, "Unreleased")
    assert f"Version {version}," in text("README.md")
    assert set(re.findall(r"mbocp-([0-9.]+)-cp", text("docs/install.md"))) == {version}


def test_the_citation_is_of_this_version() -> None:
    said, about = yaml.safe_load(text("CITATION.cff")), project()["project"]
    assert {"cff-version", "message", "title", "authors"} <= said.keys()
    assert said["version"] == about["version"] == mbocp.__version__
    assert said["license"] == about["license"]
    assert said["authors"] == about["authors"]


def test_tests_and_wheels_are_for_the_same_pythons() -> None:
    job = yaml.safe_load(text(".github/workflows/test.yml"))["jobs"]["test"]
    assert job["strategy"]["matrix"]["python"] == PYTHONS
    assert project()["project"]["requires-python"] == f">={PYTHONS[0]}"
    built = project()["tool"]["cibuildwheel"]["build"].split()
    assert built == [f"cp{python.replace('.', '')}-*" for python in PYTHONS]
    assert job["steps"][-1] == {"run": ".ci/run"}
    assert (ROOT / ".ci" / "run").stat().st_mode & 0o100


def test_nothing_needs_what_the_oldest_python_lacks() -> None:
    """Its standard library has no `tomllib`: `mbocp._files` reads TOML."""
    whole = re.compile(r"^import tomllib", re.MULTILINE)
    files = [
        file
        for folder in ("mbocp", "tests", "papers", "examples", "benchmarks")
        for file in (ROOT / folder).rglob("*.py")
    ]
    assert len(files) > 500
    assert [str(file) for file in files if whole.search(file.read_text(encoding="utf-8"))] == []


def test_wheels_leave_out_what_the_makefile_leaves_out() -> None:
    (others,) = re.findall(r"^OTHERS := (.*)$", text("Makefile"), re.MULTILINE)
    for system in ("linux", "macos"):
        command = project()["tool"]["cibuildwheel"][system]["repair-wheel-command"]
        left_out = [word.strip("'*") for word in re.findall(r"--exclude (\S+)", command)]
        assert left_out == [name.strip("*") for name in others.split()]


def conda_needs(requirements: list[str]) -> set[str]:
    """What conda's packages of these are: their names there, and versions as conda writes them."""
    found = set()
    for requirement in requirements:
        name, version = re.fullmatch(r"([a-z0-9-]+)(.*)", requirement.partition(";")[0]).groups()
        version = "" if name.startswith("cmeel") else re.sub(r"^==(.*)", r"\1.*", version)
        found.add(f"{CONDA_NAMES.get(name, name)} {version}".strip())
    return found


def test_the_recipe_of_conda_says_what_the_project_says() -> None:
    recipe, about = yaml.safe_load(text("conda/recipe.yaml")), project()["project"]
    assert recipe["context"]["version"] == about["version"]
    assert recipe["about"]["summary"] == about["description"]
    assert recipe["about"]["license"] == about["license"]
    said = recipe["requirements"]
    run = {need if isinstance(need, str) else need["then"] for need in said["run"]} - {"python"}
    assert run == conda_needs(about["dependencies"]) - {"libboost-devel"}  # `host` brings its library
    tools = {need for need in said["build"] if not need.startswith("$")}
    host = set(said["host"]) - {"python", "pip", "pinocchio-python 4.1.0.*"}
    assert tools | host == conda_needs(project()["build-system"]["requires"])


def test_the_page_of_a_package_leads_to_no_file_of_the_repository() -> None:
    page = message_from_string(distribution("mbocp").read_text("METADATA") or "").get_payload()
    assert "    pip install mbocp\n" in page
    assert re.findall(r"\]\((?!https:).*?\)", page) == []
    headings = set(re.findall(r"^## .*", text("README.md"), re.MULTILINE))
    assert headings - set(re.findall(r"^## .*", page, re.MULTILINE)) == {"## Try it", "## Where to go next"}


def test_the_oldest_casadi_has_a_job() -> None:
    job = yaml.safe_load(text(".github/workflows/test.yml"))["jobs"]["oldest"]
    (oldest,) = re.findall(r"casadi==([0-9.]+)", str(job["steps"]))
    assert any(need.startswith(f"casadi>={oldest},") for need in project()["project"]["dependencies"])
