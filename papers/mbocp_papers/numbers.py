"""Numbers of a paper's tables and figures: what there is none of is refused."""

from __future__ import annotations

from collections.abc import Collection

from mbocp.exceptions import InvalidValue


def check_number(option: str, number: int, known: Collection[int], sketches: Collection[int] = ()) -> None:
    """Refuse a number that is not among the known ones; figures that are sketches have no results.

    Raises
    ------
    InvalidValue
    """
    if number not in known:
        hint = f"one of {', '.join(map(str, known))}"
        if number in sketches:
            hint = f"{hint}; figure {number} is a sketch of the system"
        raise InvalidValue(option, number, hint)
