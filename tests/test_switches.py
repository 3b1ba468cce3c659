"""Only a formulation asks which one it is: switches elsewhere are counted, and can only become fewer."""

from __future__ import annotations

import ast
import re
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

PACKAGE = Path(__file__).parents[1] / "mbocp"
CEILING = 0  # less is better: lower it with every switch that goes
WORDS_CEILING = 0
KINDS = re.compile(r"Natural\w+|\w+Mechanics|ConfigurationSpace|\w+Formulation")
WORDS = re.compile(r"isinstance\([^)]*Natural|is_explicit|EXPLICIT_SCHEMES|is_flat|== \"natural\"")
FAMILIES = {"EXPLICIT_SCHEMES", "EULER_SCHEMES", "TAU", "TABLEAUX"}
FLAGS = {"is_explicit", "is_flat", "is_natural"}
ASKED = {"coordinates", "scheme"}
NAMED = re.compile(rf"\b(?:{'|'.join(FAMILIES | FLAGS | ASKED)})\b")  # a file without them has no switch


def switches(source: str) -> Iterator[int]:
    """Lines that ask for coordinates, for a family of schemes, or for a class that stands for one of them."""
    if not NAMED.search(source) and not ("isinstance" in source and KINDS.search(source)):
        return iter(())
    return (node.lineno for node in ast.walk(ast.parse(source)) if is_switch(node))


def is_switch(node: ast.AST) -> bool:
    if isinstance(node, ast.Call) and name_of(node.func) == "isinstance":
        return any(KINDS.fullmatch(name_of(n)) for n in ast.walk(node.args[1]))
    if isinstance(node, ast.Attribute):
        return node.attr in FLAGS and isinstance(node.ctx, ast.Load)
    return isinstance(node, ast.Compare) and is_question(node)


def is_question(node: ast.Compare) -> bool:
    """Whether coordinates or a scheme are compared with names, or something is looked up in a family."""
    sides = [node.left, *node.comparators]
    names = {name_of(side) for side in sides}
    written = any(
        isinstance(n, ast.Constant) and isinstance(n.value, str) for s in sides for n in ast.walk(s)
    )
    return bool(names & FAMILIES) or bool(names & ASKED and written)


def name_of(node: ast.AST) -> str:
    """Last part of a dotted name; empty for anything else."""
    return node.id if isinstance(node, ast.Name) else node.attr if isinstance(node, ast.Attribute) else ""


def words(source: str) -> Iterator[int]:
    """Lines with the words of such questions, wherever they stand: a plain search of the text."""
    return (number for number, line in enumerate(source.splitlines(), 1) if WORDS.search(line))


def found(lines: Callable[[str], Iterator[int]]) -> list[str]:
    inside = {PACKAGE / "formulation", PACKAGE / "lie"}  # and spaces of joints compare with each other
    paths = [path for path in sorted(PACKAGE.rglob("*.py")) if inside.isdisjoint(path.parents)]
    return [
        f"{path.relative_to(PACKAGE)}:{line}" for path in paths for line in sorted(lines(path.read_text()))
    ]


@pytest.mark.parametrize(("lines", "ceiling"), [(switches, CEILING), (words, WORDS_CEILING)])
def test_switches_on_the_formulation_only_become_fewer(
    lines: Callable[[str], Iterator[int]], ceiling: int
) -> None:
    places = found(lines)
    assert len(places) <= ceiling, "\n".join(places)
    assert len(places) == ceiling, f"the ceiling can be lowered to {len(places)}"


@pytest.mark.parametrize(
    "line",
    [
        "isinstance(space, NaturalSpace)",
        "isinstance(mechanics, (ForwardMechanics, int))",
        "programme.is_explicit and robot.drives",
        "qs if at.is_flat else zs",
        'problem.coordinates == "natural"',
        'saved.scheme in ("se2", "midpoint")',
        "problem.scheme not in EXPLICIT_SCHEMES",
        "isinstance(made, explicit.ExplicitFormulation)",
    ],
)
def test_a_switch_is_seen(line: str) -> None:
    assert list(switches(line)) == [1]


@pytest.mark.parametrize(
    "line",
    [
        "isinstance(x, float)",
        "formulation.keeps_adjoints",
        'kind == "line"',
        "is_flat = True",
        "scheme == other",
    ],
)
def test_other_questions_are_none(line: str) -> None:
    assert not list(switches(line))
