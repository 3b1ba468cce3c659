"""Transcripts on pages: what was typed after a prompt, and what was printed; and where they run.

A transcript is an indented block with lines `$ COMMAND`, whose ends may be escaped by a backslash. What
follows a command is what it printed, wrapped as one likes. Whole rows may be left out, and what `...`
stands for.
"""

from __future__ import annotations

import re
import shutil
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from mbocp.robot import load_robot

_INDENTED = re.compile(r"(?:^    .*\n(?:[ \t]*\n(?=    ))?)+", re.MULTILINE)
_BETWEEN = re.compile(r"\.\.\.|\n(?=\S)")  # a row begins at the left, its other lines do not
_NUMBER = re.compile(r"[-+]?\d+(?:\.\d+)?(?:e[-+]?\d+)?(?: m?s\b)?")  # times are seconds here, there less
_URDFS = {  # of example-robot-data, on docs/three_robots.md: a robot of the same folder, and the file
    "panda": ("panda", "panda.urdf"),
    "iris": ("iris", "iris.urdf"),
    "so101": ("so101", "so101.urdf"),
}


@dataclass(frozen=True)
class Step:
    """A command and what it printed."""

    command: str
    output: str

    def missing(self, printed: str) -> list[str]:
        """Rows of the output that are not printed, in their order; one number is as good as another."""
        rest, left_out = _plain(printed), []
        for part in filter(None, map(_plain, _BETWEEN.split(self.output))):
            _, found, after = rest.partition(part)
            if not found:
                left_out.append(part)
            rest = after if found else rest
        return left_out


def _plain(text: str) -> str:
    return " ".join(_NUMBER.sub("#", text).split())


def steps_of(page: str) -> Iterator[Step]:
    """The commands of a page with what they print."""
    for block in _INDENTED.findall(page):
        text = re.sub(r"^    ", "", block, flags=re.MULTILINE).replace("\\\n", " ")
        for part in re.split(r"^\$ ", text, flags=re.MULTILINE)[1:]:
            command, _, output = part.partition("\n")
            yield Step(" ".join(command.split()), output)


def lay_out_robots(folder: Path) -> None:
    """Put what docs/three_robots.md begins with into a folder: three URDFs, and their package in `share`."""
    for name, (robot, file) in _URDFS.items():
        (source,) = (source for source in load_robot(robot).sources if source.suffix == ".urdf")
        urdf = source.with_name(file)
        shutil.copy(urdf, folder / f"{name}.urdf")
        package = next(parent for parent in urdf.parents if parent.name == "example-robot-data")
    (folder / "share").symlink_to(package.parent)
