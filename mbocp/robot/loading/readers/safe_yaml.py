"""YAML of names: bounded in size, depth and aliases, and every scalar a text.

A few lines of YAML can stand for billions of entries (aliases of lists of aliases), so the size of what a
text stands for is counted from the parser's events before anything is built.
"""

from __future__ import annotations

from typing import Any

import yaml

from mbocp.exceptions import Unreadable

MAX_NODES = 20_000  # names, lists and tables, each as often as aliases repeat it
MAX_LEVELS = 20  # of lists and tables within each other


class _Loader(yaml.SafeLoader):  # type: ignore[misc]  # yaml has no types
    """YAML's safe loader without its numbers, dates and truth values: 2020-13-45 or `on` is a name."""


for _kind in ("bool", "int", "float", "timestamp", "binary"):
    _Loader.add_constructor(f"tag:yaml.org,2002:{_kind}", yaml.SafeLoader.construct_yaml_str)


def parse_yaml(text: str) -> Any:
    """Lists, tables, texts and None of a YAML text.

    Raises
    ------
    Unreadable
        If it is not YAML, with line and column, is nested too deeply or stands for too many entries.
    """
    try:
        _check_size(text)
        return yaml.load(text, Loader=_Loader)
    except yaml.YAMLError as error:
        raise Unreadable(f"malformed YAML: {' '.join(str(error).split())}") from error


def _check_size(text: str) -> None:
    """Count the nodes, those of aliases each time, and stop at the limits."""
    anchors: dict[str | None, int] = {}  # nodes of each anchor
    open_: list[tuple[str | None, int]] = []  # what has not ended: its anchor, and nodes before it
    count = 0
    for event in yaml.parse(text, Loader=yaml.SafeLoader):
        if isinstance(event, yaml.AliasEvent):
            if any(anchor == event.anchor for anchor, _ in open_):
                raise Unreadable(f"malformed YAML: *{event.anchor} stands within itself")
            count += anchors.get(event.anchor, 1)
        elif isinstance(event, yaml.NodeEvent):
            open_.append((event.anchor, count))
            count += 1
        if isinstance(event, yaml.ScalarEvent | yaml.CollectionEndEvent):
            anchor, before = open_.pop()
            anchors[anchor] = count - before
        if len(open_) > MAX_LEVELS:
            raise Unreadable(f"malformed YAML: lists or tables are nested more than {MAX_LEVELS} deep")
        if count > MAX_NODES:
            raise Unreadable(
                f"malformed YAML: stands for more than {MAX_NODES} entries, each counted as often as "
                "aliases repeat it"
            )
