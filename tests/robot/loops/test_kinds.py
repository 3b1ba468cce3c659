"""What holds for every kind of constraint, known or to come."""

from __future__ import annotations

import ast
from pathlib import Path

import pytest

import mbocp
from mbocp.robot.loops.constraints import CONSTRAINTS

PACKAGE = Path(mbocp.__file__).parent
KINDS = PACKAGE / "robot" / "loops" / "kinds"
DOCS = Path(__file__).parents[3] / "docs"


@pytest.mark.parametrize("kind", CONSTRAINTS)
def test_every_kind_has_a_row_in_the_documentation(kind: str) -> None:
    table = [
        line for line in (DOCS / "robots.md").read_text().splitlines() if line.startswith(f"| `{kind}` |")
    ]
    keys = [key for key in CONSTRAINTS[kind].Keys.model_fields if key not in _common()]
    assert any(all(f"`{key}`" in line for key in keys) for line in table), (kind, keys)
    assert f"`{kind}`" in (DOCS / "contact.md").read_text()


def _common() -> set[str]:
    """Keys that all of them have, or all between frames."""
    return {"name", "type", "position", "position_b", "orientation", "orientation_b"}


def test_nobody_asks_which_kind_a_constraint_is() -> None:
    """What differs from kind to kind is said by their classes."""
    classes = {kind.__name__ for kind in CONSTRAINTS.values()}
    asked = [
        f"{path.relative_to(PACKAGE)}:{node.lineno}"
        for path in PACKAGE.rglob("*.py")
        if path.parent != KINDS
        if any(name in (text := path.read_text(encoding="utf-8")) for name in classes)
        for node in ast.walk(ast.parse(text))
        if isinstance(node, ast.Call) and getattr(node.func, "id", "") == "isinstance"
        if classes & {name.id for name in ast.walk(node.args[1]) if isinstance(name, ast.Name)}
    ]
    assert not asked, asked
