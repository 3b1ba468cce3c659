"""The campaign's figures."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Any

import numpy as np

from tests.checker.check import TOLERANCES

__all__ = ["false_converged", "show", "worst"]

_HEAD = (
    "class",
    "tasks",
    "feasible",
    "converged",
    "under-resolved",
    "both, of feasible",
    "other",
    "infeasible: converged",
    "FALSE",
    "iterations",
    "time [ms]",
)


def false_converged(rows: Iterable[dict[str, Any]]) -> list[dict[str, Any]]:
    """Rows that say converged and are not, or cannot be."""
    return [r for r in rows if r["status"] == "converged" and (r.get("failures") or not r["feasible"])]


def show(rows: Sequence[dict[str, Any]], by: str = "class") -> str:
    """A table in Markdown, a row for each class and one for all."""
    names = list(dict.fromkeys(r[by] for r in rows))
    lines = [_line(name, [r for r in rows if r[by] == name]) for name in names]
    cells = [list(_HEAD), *lines, _line("all", rows)]
    widths = [max(len(row[i]) for row in cells) for i in range(len(_HEAD))]
    text = ["| " + " | ".join(c.ljust(w) for c, w in zip(row, widths, strict=True)) + " |" for row in cells]
    text.insert(1, "| " + " | ".join("-" * w for w in widths) + " |")
    return "\n".join(text)


def _line(name: str, rows: Sequence[dict[str, Any]]) -> list[str]:
    feasible = [r for r in rows if r["feasible"]]
    good = [r for r in feasible if r["status"] == "converged"]
    coarse = [r for r in feasible if r["status"] == "under_resolved"]
    others: dict[str, int] = {}
    for r in rows:
        if r["status"] not in ("converged", "under_resolved"):
            key = r["status"] + ("" if r["feasible"] else " (infeasible)")
            others[key] = others.get(key, 0) + 1
    wrong = [r for r in rows if not r["feasible"] and r["status"] == "converged"]
    return [
        name,
        str(len(rows)),
        str(len(feasible)),
        str(len(good)),
        str(len(coarse)),
        f"{100 * (len(good) + len(coarse)) / len(feasible):.1f} %" if feasible else "-",
        ", ".join(f"{k} {v}" for k, v in sorted(others.items())) or "-",
        f"{len(wrong)} of {len(rows) - len(feasible)}",
        str(len(false_converged(rows))),
        _spread([r["iterations"] for r in good]),
        _spread([1e3 * r["seconds"] for r in good]),
    ]


def _spread(values: Sequence[float]) -> str:
    if not values:
        return "-"
    return f"{np.median(values):.0f} / {np.quantile(values, 0.9):.0f} / {max(values):.0f}"


def worst(rows: Sequence[dict[str, Any]]) -> str:
    """Largest of each measure over all that converged."""
    lines = ["| measure | tolerance | largest | at |", "| --- | --- | --- | --- |"]
    checked = [r for r in rows if r["status"] == "converged"]
    for name, bound in TOLERANCES.items():
        if checked:
            top = max(checked, key=lambda r, name=name: r["report"][name])
            where = f"{top['class']} {top['seed']}"
            lines.append(f"| {name} | {bound:.0e} | {top['report'][name]:.1e} | {where} |")
    return "\n".join(lines)
