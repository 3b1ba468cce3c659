"""The stubs of the native modules say what these have: names, parameters with their defaults, types."""

from __future__ import annotations

import ast
import importlib
import re
from pathlib import Path
from types import ModuleType
from typing import Any

import pytest

from mbocp.programme.native_modules import kernel

NATIVE = Path(__file__).parents[1] / "mbocp" / "_native"
MODULES = ("_bridge", "_nlp", "_room")
_ARRAY = re.compile(r"(numpy\.)?ndarray\[dtype=float64[^\]]*\]")
_QUALIFIED = re.compile(r"(mbocp\._native\._\w+|collections\.abc)\.")


def signature(f: Any, name: str) -> str:
    """What nanobind knows of a function, as a line of a stub."""
    ((text, _, defaults),) = f.__nb_signature__
    text = _QUALIFIED.sub("", _ARRAY.sub("Array", text))
    text = re.sub(r"\\(\d)", lambda match: repr(defaults[int(match[1])]), text)
    return ast.unparse(ast.parse(text.replace("def (", f"def {name}(") + ": ..."))


def of_module(module: ModuleType) -> dict[str, str]:
    found: dict[str, str] = {}
    for name, value in vars(module).items():
        if name.startswith("__"):
            continue
        if isinstance(value, str):
            found[name] = f"{name}: str"
        elif not isinstance(value, type):
            found[name] = signature(value, name)
        for key, member in vars(value).items() if isinstance(value, type) else ():
            if isinstance(member, property):
                found[f"{name}.{key}"] = signature(member.fget, key)
                found[f"{name}.{key} is"] = "writable" if member.fset else "read-only"
            elif hasattr(member, "__nb_signature__"):
                found[f"{name}.{key}"] = signature(member, key)
    return found


def of_stub(path: Path) -> dict[str, str]:
    found: dict[str, str] = {}

    def add(node: ast.stmt, owner: str = "") -> None:
        if isinstance(node, ast.ClassDef):
            for member in node.body:
                add(member, f"{node.name}.")
        elif isinstance(node, ast.AnnAssign) and not owner:
            found[ast.unparse(node.target)] = ast.unparse(node)
        elif isinstance(node, ast.AnnAssign):  # a writable property
            assert isinstance(node.target, ast.Name)
            name = node.target.id
            found[owner + name] = ast.unparse(
                ast.parse(f"def {name}(self) -> {ast.unparse(node.annotation)}: ...")
            )
            found[f"{owner}{name} is"] = "writable"
        elif isinstance(node, ast.FunctionDef):
            decorators = [ast.unparse(d) for d in node.decorator_list]
            node.decorator_list = []
            found[owner + node.name] = ast.unparse(node)
            if "property" in decorators:
                found[f"{owner}{node.name} is"] = "read-only"

    for statement in ast.parse(path.read_text()).body:
        add(statement)
    return found


@pytest.mark.parametrize("name", ["_kernel", *MODULES])
def test_stub_and_module_agree(name: str) -> None:
    module = kernel() if name == "_kernel" else importlib.import_module(f"mbocp._native.{name}")
    found = of_module(module)
    assert found
    assert of_stub(NATIVE / f"{name}.pyi") == found
