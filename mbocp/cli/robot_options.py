"""Options with which a command loads a robot: the same wherever one is named."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import typer

from mbocp.exceptions import MbocpError, RobotError, UnsupportedRobot

if TYPE_CHECKING:
    from mbocp.robot import Robot

ROOT = "root_joint"  # under a base that floats


@dataclass(frozen=True)
class RobotOptions:
    """What `--package-dir`, `--free-flyer`, `--no-dynamics` and `--lock` say.

    Parameters
    ----------
    package_dirs : sequence of Path, optional
        Folders that hold the packages of ``package://`` addresses.
    free_flyer : bool, optional
        Whether the root link floats; None: what the robot says.
    dynamics : bool, optional
        Whether forces move the robot; None: what the robot says.
    locks : sequence of str, optional
        ``JOINT``, or ``JOINT=VALUE`` with an angle [rad] or a length [m].
    """

    package_dirs: Sequence[Path] | None = None
    free_flyer: bool | None = None
    dynamics: bool | None = None
    locks: Sequence[str] | None = None

    def table(self, name: str) -> dict[str, Any]:
        """The table `[robot]` of a problem file that says the same, with absolute folders."""
        table: dict[str, Any] = {"name": name}
        for key in ("free_flyer", "dynamics"):
            if getattr(self, key) is not None:
                table[key] = getattr(self, key)
        if self.locks:
            table["lock"] = _lock(self.locks)
        if self.package_dirs:
            table["package_dirs"] = [str(folder.resolve()) for folder in self.package_dirs]
        return table

    def load(self, name: str) -> Robot:
        """Load a robot.

        Raises
        ------
        RobotError
            For all that `load_robot` refuses, and a value of a lock that is no number.
        """
        from mbocp.robot import robot_from_spec

        return robot_from_spec(self.table(name))

    def load_as_it_can_move(self, name: str) -> tuple[RobotOptions, Robot]:
        """Load a robot, and tell if it has no dynamics: one without inertias is taken to have none.

        One of which no joint moves is taken to float.

        Returns
        -------
        options : RobotOptions
            With which it was loaded.
        robot : Robot

        Raises
        ------
        RobotError
            As of `load`.
        """
        options, robot = self._that_load(name)
        if options.dynamics is False:
            typer.echo(
                f"note: {robot.name} moves without dynamics: its controls are accelerations, and nothing is "
                "known of its torques; robot.inertias in place of robot.dynamics estimates its masses",
                err=True,
            )
        return options, robot

    def _that_load(self, name: str) -> tuple[RobotOptions, Robot]:
        from mbocp.robot.loading.mechanics_checks import SingularMassMatrix

        try:
            return self, self.load(name)
        except UnsupportedRobot as error:
            if self.free_flyer is None and "no joint that moves" in str(error):
                other = replace(self, free_flyer=True)
            elif self.dynamics is None and isinstance(error, SingularMassMatrix) and error.are_all:
                other = replace(self, dynamics=False)
            else:
                raise
            try:
                return other, other.load(name)
            except MbocpError:
                raise error from None


def _lock(locks: Sequence[str]) -> list[str] | dict[str, float]:
    pairs = [lock.partition("=") for lock in locks]
    if not any(sign for _, sign, _ in pairs):
        return [joint for joint, _, _ in pairs]
    values = {}
    for joint, sign, text in pairs:
        if not sign:
            raise RobotError(f"--lock {joint}: give each joint a value, JOINT=VALUE, or none of them")
        try:
            values[joint] = float(text)
        except ValueError:
            raise RobotError(f"--lock {joint}={text}: expected a number [rad, m]") from None
    return values
