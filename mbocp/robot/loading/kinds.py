"""Kinds of sources of robots, which files of robots name, too."""

from __future__ import annotations

from typing import Literal, TypeAlias

Kind: TypeAlias = Literal["toml", "yaml", "urdf", "chain", "example"]
