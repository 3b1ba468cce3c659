"""Blocks of code on the pages are code: Python runs, tables are problem files, keys and options exist."""

from __future__ import annotations

import importlib.util
import re
import shutil
import subprocess
import sys
from collections.abc import Iterator, Mapping
from copy import deepcopy
from pathlib import Path
from types import ModuleType
from typing import Any

import pytest

import mbocp
from mbocp._keys import tables_in
from mbocp.problem.file.keys_page import all_keys, rows
from mbocp.problem.file.read_tables import ProblemTable
from mbocp.problem.problem import problem_from_tables

if sys.version_info >= (3, 11):
    import tomllib
else:
    import tomli as tomllib

ROOT = Path(__file__).parent.parent
DOCS = ROOT / "docs"
FENCE = re.compile(r"^```(\w+)\n(.*?)^```", re.MULTILINE | re.DOTALL)
INDENTED = re.compile(r"(?:^    .*\n(?:[ \t]*\n(?=    ))?)+", re.MULTILINE)
SETTING = re.compile(r"--set ['\"]?([a-z_]+(?:\.\w+)*)=")
PRELUDES = {  # what the text above a block has said
    "bounds.md": "import mbocp\nsolution = mbocp.solve('examples/optima/bryson_denham.toml')",
    "estimation.md": "import numpy as np\n"
    "_left = iter(range(20))\n"
    "is_running = lambda: next(_left, None) is not None\n"
    "sample = lambda: (robot.q0, np.zeros(6))\n"
    "def send(q, v, mass): assert q.shape == v.shape == (6,)",
    "identification.md": "from pathlib import Path\nimport mbocp\n"
    "from mbocp.identification import simulate_log, write_log\n"
    "from mbocp.problem.file.tables import problem_to_toml\n"
    "robot = mbocp.load_robot('ur5')\n"
    "for k, name in enumerate(('log.csv', 'other.csv')):\n"
    "    write_log(simulate_log(robot, duration=2.0, seed=k), name)\n"
    "pendulum = mbocp.Problem.create('chain_2', 2.0, 20, goal={'q': [0.5, 0.5], 'v': 0}, "
    "limits={'velocity': 3, 'acceleration': 20})\n"
    "Path('problem.toml').write_text(problem_to_toml(pendulum))",
    "problem_files.md": "import mbocp",
    "receding_horizon.md": "import mbocp\n"
    "_left = iter(range(20))\n"
    "goal = mbocp.load_problem('examples/receding/ur5_follow.toml').goal.q\n"
    "is_running = lambda: next(_left, None) is not None\n"
    "measured = lambda: (horizon.problem.q_start, horizon.problem.v_start)\n"
    "def command(u): assert u.shape == (6,)",
    "robots.md": "import mbocp",
    "results.md": "import mbocp",
    "sensitivities.md": "import mbocp\nexample = mbocp.load_problem('examples/arms/ur5_reach.toml')\n"
    "q, goal = example.q_start, example.goal.q",
    "terms.md": "import numpy as np\nfrom mbocp.problem import parse_problem\n"
    "from mbocp.terms import end_condition, path_constraint",
}


def page_names(language: str) -> list[str]:
    """Pages with fenced blocks of a language."""
    return [p.name for p in sorted(DOCS.glob("*.md")) if f"\n```{language}\n" in p.read_text("utf-8")]


def blocks(page: str, language: str) -> list[str]:
    """Fenced blocks of a language, in order."""
    return [block for name, block in FENCE.findall((DOCS / page).read_text("utf-8")) if name == language]


def load_tool(name: str) -> ModuleType:
    """One of the modules that make the site, which are no package."""
    spec = importlib.util.spec_from_file_location(f"docs_site_{name}", DOCS / "site" / f"{name}.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules[spec.name] = module  # dataclasses look for it
    spec.loader.exec_module(module)
    return module


@pytest.fixture(scope="module")
def known() -> dict[str, bool]:
    """Dotted keys of problem files, and whether each is a table with keys of its own."""
    return {name: bool(tables_in(info.annotation)) for name, info in all_keys()}


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Where the code of a page runs: with examples and robots, and with the files that it is about."""
    for name in ("examples", "robots"):
        (tmp_path / name).symlink_to(ROOT / name)
    monkeypatch.chdir(tmp_path)
    return tmp_path


@pytest.mark.slow
@pytest.mark.parametrize(
    "page", [p for p in page_names("python") if p != "studies.md"]
)  # that one: tests/study
def test_python_runs(page: str, folder: Path) -> None:
    if page == "live.md":
        pytest.importorskip("viser", reason="pip install 'mbocp[live]'")
    if page == "results.md":
        problem = mbocp.load_problem("examples/arms/ur5_reach.toml")
        mbocp.solve(problem).save("ur5.h5")
    if page == "symbolic.md":
        shutil.copy(mbocp.load_robot("ur5").sources[0], "robot.urdf")
    namespace: dict[str, Any] = {"__name__": "page"}
    exec(PRELUDES.get(page, ""), namespace)
    for block in blocks(page, "python"):
        if "import jax" in block:
            pytest.importorskip("jax", reason="pip install 'mbocp[jax]'")
        exec(compile(block, page, "exec"), namespace)


def merged(tables: dict[str, Any], more: Mapping[str, Any]) -> dict[str, Any]:
    """Tables with the keys of others put in."""
    for name, value in more.items():
        if isinstance(value, Mapping) and isinstance(tables.get(name), dict):
            merged(tables[name], value)
        else:
            tables[name] = deepcopy(value)
    return tables


WISHES = [tomllib.loads(block) for block in blocks("wishes.md", "toml")]


@pytest.mark.parametrize("wish", WISHES, ids=lambda wish: "-".join(wish))
def test_wishes_are_granted(wish: dict[str, Any]) -> None:
    """Each is a part of a problem that is well posed, together with the file above them."""
    tables = deepcopy(WISHES[0])
    ends_elsewhere = "goal" in wish or any(path.get("kind") == "follow" for path in wish.get("path", []))
    if wish is not WISHES[0] and ends_elsewhere:
        del tables["goal"]["q"]
    problem = problem_from_tables(merged(tables, wish), source=None, label="wishes.md")
    assert problem.num_steps == 50


def table_blocks() -> Iterator[object]:
    """Blocks of tables, fenced and indented; those of robot.toml name no table of problem files."""
    for page in sorted(DOCS.glob("*.md")):
        text = page.read_text("utf-8")
        fenced = [block for name, block in FENCE.findall(text) if name == "toml"]
        plain = [re.sub(r"^    ", "", b, flags=re.MULTILINE) for b in INDENTED.findall(FENCE.sub("", text))]
        for i, block in enumerate([*fenced, *(b for b in plain if re.match(r"\[+[a-z]+[\].]", b))]):
            yield pytest.param(page.name, block, id=f"{page.name}-{i}")


@pytest.mark.parametrize(("page", "block"), [*table_blocks()])
def test_tables_have_keys_that_exist(page: str, block: str, known: dict[str, bool]) -> None:
    tables = tomllib.loads(block)
    if set(tables) <= set(ProblemTable.model_fields) and page != "studies.md":
        for name in named_keys(tables, known):
            assert name in known, name


def named_keys(tables: Any, known: Mapping[str, bool], under: str = "") -> Iterator[str]:
    """Dotted names of what tables say, down to those whose keys are names of joints or the like."""
    for table in tables if isinstance(tables, list) else [tables]:
        for key, value in table.items() if isinstance(table, Mapping) else ():
            yield under + key
            if known.get(under + key):
                yield from named_keys(value, known, f"{under}{key}.")


@pytest.mark.parametrize("page", [p.name for p in sorted(DOCS.glob("*.md"))])
def test_settings_name_keys(page: str, known: dict[str, bool]) -> None:
    refused = {"horizon.stepps", "goal.gamma"}  # on the page about errors
    for name in SETTING.findall((DOCS / page).read_text("utf-8")):
        parts = [part for part in name.split(".") if not part.isdigit()]
        if parts[0] == "phase":
            del parts[1]  # a phase goes by its name
        ends = [".".join(parts[:n]) for n in range(1, len(parts) + 1)]
        leaf = next((end for end in ends if not known.get(end, True)), ends[-1])
        assert leaf in known or (page == "problem_files.md" and name in refused), name


def test_every_key_is_explained(known: dict[str, bool]) -> None:
    """Those of weights with them."""
    assert {re.sub(r"(_weights)\.qp$", r"\1", name) for name in known} == set(rows())


def test_keys_of_every_day_exist(known: dict[str, bool]) -> None:
    (words,) = re.findall(
        r"^Of every day: (.+?)\n\n", (DOCS / "keys.md").read_text("utf-8"), re.MULTILINE | re.DOTALL
    )
    names = re.findall(r"`(.+?)`", words)
    assert len(names) > 20
    assert set(names) <= set(known)


def test_the_reference_has_every_public_name() -> None:
    page = (DOCS / "api.md").read_text("utf-8")
    for name in mbocp.__all__:
        assert name == "__version__" or re.search(rf":: mbocp\.{name}$", page, re.MULTILINE), name
    for path in re.findall(r"^\.\. auto\w+:: (\S+)$", page, re.MULTILINE):
        home, _, name = path.rpartition(".")
        assert hasattr(importlib.import_module(home), name), path


def test_every_example_is_in_the_gallery() -> None:
    gallery = load_tool("make_gallery")
    shown = {example.resolve() for example in gallery.examples()}
    assert len(shown) > 40
    others = {p for p in (ROOT / "examples").glob("*/*.toml") if p.resolve() not in shown}
    left_out = {p.stem for p in others if p.parent.name != "studies"}
    assert left_out == gallery.NO_SINGLE_MOTION, "a new folder of examples goes into make_gallery.ROOMS"


def test_pictures_are_of_examples() -> None:
    for page in DOCS.glob("*.md"):
        for name in re.findall(r"^<!-- example: (\S+) -->$", page.read_text("utf-8"), re.MULTILINE):
            assert (ROOT / "examples" / f"{name}.toml").exists(), f"{page.name}: {name}"


@pytest.mark.slow
def test_the_site_is_made_without_a_warning(tmp_path: Path) -> None:
    pytest.importorskip("furo", reason="pip install --group docs")
    command = [sys.executable, "-m", "sphinx", "-q", "-W", "--keep-going", "-b", "html"]
    done = subprocess.run(
        [*command, str(DOCS), str(tmp_path / "site")], capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr
    for page in DOCS.glob("*.md"):
        made = (tmp_path / "site" / f"{page.stem}.html").read_text("utf-8")
        assert not re.findall(r"<(?:script|link|img)[^>]+(?:src|href)=\"(?:https?:)?//", made), page.name
