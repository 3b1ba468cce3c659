"""Environments of the solvers: mbocp's own, and one for Crocoddyl, whose wheel needs another Pinocchio."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path

__all__ = ["Environment", "environment_of_crocoddyl", "own_environment"]

_PACKAGES = ("crocoddyl==3.2.1", "mim-solvers==0.3.0", "pin==4.0.0", "libpinocchio==4.0.0")
_NEEDED = {"pin": "4.0.0", "libpinocchio": "4.0.0"}
_VERSIONS = (
    "import json, importlib.metadata as m\n"
    "print(json.dumps({d.metadata['Name'].lower().replace('_', '-'): d.version for d in m.distributions()}))"
)


@dataclass(frozen=True)
class Environment:
    """A Python with packages, or the reason why there is none.

    Attributes
    ----------
    python : Path
    versions : dict of str to str
    reason : str
        Empty where it can be used.
    """

    python: Path
    versions: dict[str, str]
    reason: str = ""

    def has(self, package: str) -> bool:
        """Whether a package is there."""
        return not self.reason and package in self.versions


def own_environment() -> Environment:
    """The one that this runs in."""
    python = Path(sys.executable)
    return Environment(python, _versions(python))


def environment_of_crocoddyl() -> Environment:
    """Built once, in the user's cache; with other versions than it needs it is refused."""
    folder = (
        Path(os.environ.get("XDG_CACHE_HOME", Path.home() / ".cache")) / "mbocp" / "peers" / "crocoddyl-3.2.1"
    )
    python = folder / "bin" / "python"
    if not (folder / "complete").exists():
        print(f"Installing {' '.join(_PACKAGES)} into {folder}", file=sys.stderr, flush=True)
        commands = (
            [sys.executable, "-m", "venv", str(folder)],
            [str(python), "-m", "pip", "install", "--quiet", "--disable-pip-version-check", *_PACKAGES],
        )
        for command in commands:
            done = subprocess.run(command, capture_output=True, text=True, check=False)
            if done.returncode:
                said = (done.stderr or done.stdout).strip().splitlines()
                return Environment(python, {}, f"not installed: {said[-1] if said else 'pip failed'}")
        (folder / "complete").touch()
    found = _versions(python)
    wrong = [f"{name} {found.get(name)}" for name, version in _NEEDED.items() if found.get(name) != version]
    if wrong:
        reason = (
            f"refused: {', '.join(wrong)} in {folder}, where Crocoddyl's wheel needs 4.0.0; remove the folder"
        )
        return Environment(python, found, reason)
    return Environment(python, found)


def _versions(python: Path) -> dict[str, str]:
    said = subprocess.run([str(python), "-c", _VERSIONS], capture_output=True, text=True, check=True)
    versions: dict[str, str] = json.loads(said.stdout)
    return versions
