"""What the site adds to the pages: navigation from the index, pictures and replays.

Pages say in comments where: `<!-- gallery -->`, `<!-- notebooks -->`, and `<!-- example: arms/cup -->`.
Read as plain Markdown they are pages without these; what such a reader should see instead stands between the
comment and `<!-- end -->`.
"""

from __future__ import annotations

import json
import re
import shutil
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import make_gallery
from sphinx.application import Sphinx

ROOT = Path(__file__).resolve().parents[2]
_COMMENT = re.compile(
    r"^<!-- (example|gallery|notebooks)(?:: ([^>]+))? -->$(?:(?:(?!^<!-- ).)*?^<!-- end -->$)?",
    re.MULTILINE | re.DOTALL,
)
_OUTSIDE = re.compile(r"\]\((\.\./[^)#]+\.md)\)")  # to pages that are not of the site
_PAGE = re.compile(r"\]\((\w+)\.md\)")


def navigation(index: str) -> str:
    """Table of contents for the sidebar: a group for each heading of the index, its links in order."""
    found = []
    for group in re.split(r"^## ", index, flags=re.MULTILINE)[1:]:
        title, _, body = group.partition("\n")
        pages = "\n".join(dict.fromkeys(_PAGE.findall(body)))
        found.append(f"```{{toctree}}\n:hidden:\n:caption: {title}\n\n{pages}\n```\n")
    return "\n".join(found)


def picture(name: str) -> str:
    """An example's picture, which opens its replay, and what it took; nothing where it has not been made."""
    stem = name.replace("/", "-")
    found = make_gallery.FOLDER / f"{stem}.json"
    if not found.exists():
        return ""
    lines = [
        f"```{{image}} ../build/gallery/{stem}.png",
        f":alt: {_title(name)}",
        f":target: replays/{stem}.html",
        "```",
        "",
        f"{_replay(stem)} · [problem file](../examples/{name}.toml) · {_numbers(found)}",
    ]
    return "\n".join(lines)


def _replay(stem: str) -> str:
    return f'<a href="replays/{stem}.html">Replay</a>'


def gallery() -> str:
    """All examples, room by room, as cards."""
    parts: list[str] = []
    room = ""
    for example in make_gallery.examples():
        if example.parent.name != room:
            parts += ["::::", ""] * bool(room)
            room = example.parent.name
            parts += [f"## {make_gallery.ROOMS[room]}", "", "::::{grid} 1 2 2 2", ":gutter: 3", ""]
        parts += _card(example)
    return "\n".join([*parts, "::::", ""])


def _card(example: Path) -> Iterator[str]:
    name, stem = f"{example.parent.name}/{example.stem}", make_gallery.name_of(example)
    summary = make_gallery.FOLDER / f"{stem}.json"
    yield f":::{{grid-item-card}} {example.stem.replace('_', ' ')}"
    if summary.exists():
        yield f":img-top: ../build/gallery/{stem}.png"
        yield f":img-alt: {_title(name)}"
    yield ""
    yield f"{_title(name)}"
    yield ""
    if summary.exists():
        yield f"{_replay(stem)} · [file](../examples/{name}.toml) · {_numbers(summary)}"
    else:
        yield f"[file](../examples/{name}.toml)"
    yield ":::"
    yield ""


def notebooks() -> str:
    """All notebooks, one below the other: text and code."""
    files = sorted((ROOT / "docs" / "notebooks").glob("*.ipynb"))
    cells = (cell for file in files for cell in json.loads(file.read_text(encoding="utf-8"))["cells"])
    return "\n\n".join(_cell(cell["cell_type"], "".join(cell["source"])) for cell in cells)


def _cell(kind: str, source: str) -> str:
    """A cell as Markdown; its headings stand below the page's own."""
    return f"```python\n{source}\n```" if kind == "code" else re.sub(r"^#", "##", source, flags=re.MULTILINE)


def _title(name: str) -> str:
    """First paragraph of the comment at the head of an example."""
    lines = (ROOT / "examples" / f"{name}.toml").read_text(encoding="utf-8").splitlines()
    words = []
    for line in lines:
        if not line.startswith("# "):
            break
        words.append(line[2:])
    return " ".join(words).replace("[", "").replace("]", "") or Path(name).stem


def _numbers(summary: Path) -> str:
    """What a solve came to, in a few words."""
    said = json.loads(summary.read_text())
    span = f"{said['duration']:.3g} s in {said['num_steps']} steps"
    return f"{span}, {said['iterations']} iterations, cost {said['cost']:.4g}"


def _expanded(app: Sphinx, name: str, content: list[str]) -> None:
    makers = {
        "example": picture,
        "gallery": lambda _: gallery(),
        "notebooks": lambda _: notebooks(),
    }
    content[0] = _COMMENT.sub(lambda found: makers[found.group(1)](found.group(2)), content[0])
    content[0] = _OUTSIDE.sub(r"](path:\1)", content[0])
    if name == app.config.root_doc:
        content[0] += "\n" + navigation(content[0])


def _copied(app: Sphinx, error: Exception | None) -> None:
    if error is None:
        replays = Path(app.outdir) / "replays"
        replays.mkdir(exist_ok=True)
        for page in make_gallery.FOLDER.glob("*.html"):
            shutil.copy(page, replays / page.name)


def setup(app: Sphinx) -> dict[str, Any]:
    """Register all of it."""
    app.connect("source-read", _expanded)
    app.connect("build-finished", _copied)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
