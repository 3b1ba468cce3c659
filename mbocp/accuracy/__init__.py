"""How far a discrete motion is from what the robot would do."""

from __future__ import annotations

from typing import TYPE_CHECKING

from mbocp._exports import names_of

if TYPE_CHECKING:
    from mbocp.accuracy.errors import accuracy_of as accuracy_of
    from mbocp.accuracy.solution_accuracy import follows_fast as follows_fast
    from mbocp.accuracy.solution_accuracy import with_accuracy as with_accuracy


__getattr__ = names_of(__name__, __file__)
