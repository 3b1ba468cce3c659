"""The documentation says what is so: links, commands, keys, problem files and Python examples."""

from __future__ import annotations

import importlib
import re
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
import typer

import mbocp
from mbocp.cli.app import COMMANDS, app_for, load_command
from mbocp.problem.file.keys_page import update_page
from mbocp.problem.file.load import parse_problem
from mbocp.problem.file.read_tables import ProblemTable
from mbocp.problem.file.tables import problem_to_toml
from mbocp.solution.details import Status
from mbocp.storage.content import QUANTITIES

ROOT = Path(__file__).parent.parent
PAGES = [
    ROOT / "README.md",
    ROOT / "CHANGELOG.md",
    *sorted((ROOT / "docs").glob("*.md")),
    ROOT / "docs/llms.txt",
]
FENCE = re.compile(r"^```(\w+)\n(.*?)^```", re.MULTILINE | re.DOTALL)
LINK = re.compile(r"\[[^\]\[]*\]\(([^)\s]+)\)")
COMMAND = re.compile(r"(?:^    (?:\$ |\S*/)?|`)mbocp ([a-z]+)((?: [^`|\n]*)?)", re.MULTILINE)
KEY = re.compile(r"\[([A-Z][A-Za-z]+\d{4}[a-z]?)\]")


def text(page: str) -> str:
    return (ROOT / page).read_text(encoding="utf-8")


def blocks(language: str) -> Iterator[object]:
    """Fenced blocks of problem files or Python, each named by its page and place."""
    for page in (ROOT / "README.md", ROOT / "docs" / "problem_files.md"):
        for i, (name, block) in enumerate(FENCE.findall(page.read_text(encoding="utf-8"))):
            if name == language and (name != "toml" or block.startswith("robot = ")):
                yield pytest.param(block, id=f"{page.name}-{i}")


def anchors(page: Path) -> set[str]:
    """Anchors of a page's headings, as hosting sites make them."""
    headings = re.findall(r"^#+ (.+)$", page.read_text(encoding="utf-8"), re.MULTILINE)
    return {re.sub(r"[^\w\- ]", "", heading.lower()).replace(" ", "-") for heading in headings}


@pytest.mark.parametrize("page", PAGES, ids=lambda p: p.name)
def test_links_lead_somewhere(page: Path) -> None:
    for target in LINK.findall(page.read_text(encoding="utf-8")):
        if target.startswith(("http://", "https://")):
            continue
        name, _, anchor = target.partition("#")
        path = (page.parent / name) if name else page
        assert path.exists(), f"{page.name}: {target}"
        if anchor:
            assert anchor in anchors(path), f"{page.name}: {target}"


@pytest.mark.parametrize("page", PAGES, ids=lambda p: p.name)
def test_files_of_the_project_exist(page: Path) -> None:
    named = re.findall(r"(?:examples|robots|docs|benchmarks)/[\w./-]*\w", page.read_text(encoding="utf-8"))
    for name in named:
        assert (ROOT / name).exists(), f"{page.name}: {name}"


def test_the_front_page_says_what_ci_runs() -> None:
    calls = re.findall(r"^make (?!setup)\w+", text(".ci/run"), re.MULTILINE)
    assert "make test" in calls
    for call in calls:
        assert call in text("README.md"), call


def test_every_page_is_in_the_index() -> None:
    index = text("docs/index.md")
    for page in (ROOT / "docs").glob("*.md"):
        assert page.name == "index.md" or f"({page.name})" in index


@pytest.mark.parametrize("block", [*blocks("toml")])
def test_problem_files_load(block: str) -> None:
    problem = parse_problem(block)
    assert problem.num_steps == (20 if problem.accuracy is not None else 100)


def test_the_lists_of_keys_are_those_of_their_declarations() -> None:
    """`python -m mbocp.problem.file.keys_page docs/keys.md` writes them."""
    page = text("docs/keys.md")
    assert update_page(page) == page
    assert page.count("\n## ") == len(ProblemTable.model_fields)


def all_commands() -> dict[str, Any]:
    """Commands of the command line, those of other packages, too, as typer's own objects."""
    group: Any = typer.main.get_command(app_for([]))
    return {**group.commands, **{name: load_command(name) for name in COMMANDS}}


@pytest.mark.parametrize("page", PAGES, ids=lambda p: p.name)
def test_commands_and_options_exist(page: Path) -> None:
    commands = all_commands()
    for name, rest in COMMAND.findall(page.read_text(encoding="utf-8")):
        assert name in commands, f"{page.name}: mbocp {name}"
        known = {option for p in commands[name].params for option in (*p.opts, *p.secondary_opts)}
        for option in re.findall(r"(?<= )--?[a-z][a-z-]*", rest.partition(" | ")[0]):
            assert option in known, f"{page.name}: mbocp {name} {option}"


def test_every_command_is_told_where_one_begins() -> None:
    for name in all_commands():
        assert f"\n- `mbocp {name}" in text("docs/getting_started.md")


def test_every_status_is_explained() -> None:
    assert all(f"| `{status}` |" in text("docs/solver.md") for status in Status)


def test_every_key_of_the_summary_is_explained() -> None:
    problem = mbocp.load_problem(ROOT / "examples/paper/rigid_pendulum.toml", {"horizon.steps": 4})
    solution = mbocp.solve(problem)
    page = text("docs/results.md")
    for key in solution.to_dict():
        assert f"`{key}`" in page, key


def test_every_quantity_of_a_result_is_explained() -> None:
    """With the axis that its rows run over."""
    rows = re.findall(r"^\| (`[^|]*`) \| [^|]* \|([^|]*)\| [^|]* \|$", text("docs/results.md"), re.MULTILINE)
    told = {name: words.strip() for names, words in rows for name in re.findall(r"`(\w+)`", names)}
    axes = {"node": "nodes", "later node": "nodes 1..N", "step": "steps", "side": "lower, upper"}
    for name, quantity in QUANTITIES.items():
        assert name in told, name
        if quantity.axes[0] in axes:
            assert told[name] == axes[quantity.axes[0]], name


def test_references_have_an_entry() -> None:
    entries = set(re.findall(r"^- \*\*\[(\w+)\]\*\*", text("docs/references.md"), re.MULTILINE))
    sources = [*PAGES, *(ROOT / "mbocp").rglob("*.py")]
    for source in sources:
        for key in KEY.findall(source.read_text(encoding="utf-8")):
            assert key in entries, f"{source}: [{key}]"


def test_the_python_example_of_the_readme_runs(tmp_path: Path) -> None:
    (example,) = [block for name, block in FENCE.findall(text("README.md")) if name == "python"]
    small = example.replace("100, start", "20, start").replace("num_steps=1000", "num_steps=30")
    assert small != example
    done = subprocess.run(
        [sys.executable, "-c", small], cwd=tmp_path, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr
    assert done.stdout.startswith("converged ")
    assert (tmp_path / "ur5.h5").exists()


def test_the_example_of_the_readme_is_the_first_problem_file(tmp_path: Path) -> None:
    (example,) = [block for name, block in FENCE.findall(text("README.md")) if name == "python"]
    first = next(block for name, block in FENCE.findall(text("docs/problem_files.md")) if name == "toml")
    made, _, _ = example.partition("solution =")
    names: dict[str, Any] = {}
    exec(made, names)
    file = tmp_path / "readme.toml"
    file.write_text(first)
    in_python, in_toml = (problem.with_(name="") for problem in (names["problem"], mbocp.load_problem(file)))
    assert problem_to_toml(in_python) == problem_to_toml(in_toml)


def pictures() -> dict[str, Path]:
    """All pictures of the pages, by their place in docs/images."""
    folder = ROOT / "docs" / "images"
    return {path.relative_to(folder).as_posix(): path for path in folder.rglob("*") if path.is_file()}


def test_pictures_are_small_and_shown() -> None:
    pages = "".join(page.read_text(encoding="utf-8") for page in PAGES)
    for name, path in pictures().items():
        assert path.stat().st_size < 400_000, name
        assert f"images/{name})" in pages, name


def test_every_picture_is_made_by_a_command(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.syspath_prepend(ROOT / "docs" / "site")
    made = importlib.import_module("make_images").made()
    others = {name for name in pictures() if name not in made}
    assert made <= set(pictures())
    figures = re.compile(r"paper_fig\d\.png|so3/so3_fig\d+\.png|work_precision_\w+\.png|live\.png")
    assert all(figures.fullmatch(name) for name in others), others


def test_the_functions_of_the_architecture_exist() -> None:
    names = re.findall(r"`(mbocp(?:\.\w+)+)`", text("docs/architecture.md"))
    assert len(names) > 9
    for name in names:
        home, _, function = name.rpartition(".")
        assert hasattr(importlib.import_module(home), function), name


@pytest.mark.parametrize(("page", "least"), [("docs/architecture.md", 20), ("CONTRIBUTING.md", 4)])
def test_the_files_of_the_architecture_exist(page: str, least: int) -> None:
    places = re.findall(r"`((?:\w+/)+(?:\w+\.py)?)`", text(page))
    assert len(places) > least
    for place in places:
        found = (ROOT / place).exists() or any((ROOT / "mbocp").rglob(place.rstrip("/")))
        assert found, place
