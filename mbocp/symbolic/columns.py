"""Columns of tables that numbers choose while a function is called.

CasADi writes no operations on numbers for them. So they are functions of their own, which stay calls wherever
others are written out, and whose names say what they do: tapes do it themselves, and so does the kernel's C.
"""

from __future__ import annotations

import casadi as ca

# Their names; `mbocp/_native/kernel/graph.cpp` has them, too.
CHOOSE, ADD_CHOSEN = "choose_columns", "add_chosen_columns"
# The name of functions that are zero where their first input is: C calls them where it is not in some stage.
WHERE_ANY = "where_any"
STAYS_A_CALL = {"never_inline": True}  # where a function is written out that calls it


def choose_columns(table: ca.MX, which: ca.MX) -> ca.MX:
    """Return the columns of a table with these numbers, shape (rows, which.numel()).

    Parameters
    ----------
    table : casadi.MX, shape (rows, columns), dense
    which : casadi.MX
        Numbers from 0 on; the result has NaN for others.
    """
    t, w = ca.MX.sym("table", *table.shape), ca.MX.sym("which", 1, which.numel())
    return ca.Function(CHOOSE, [t, w], [t[:, w]], STAYS_A_CALL)(table, ca.reshape(which, 1, -1))


def add_chosen_columns(columns: int, which: ca.MX, shares: ca.MX) -> ca.MX:
    """Return a table of so many columns, each the sum of the shares that `which` gives it.

    Parameters
    ----------
    columns : int
    which : casadi.MX
        For each share the number of a column, from 0 on; shares with others count nowhere.
    shares : casadi.MX, shape (rows, which.numel()), dense
    """
    plain, s = ca.MX.sym("plain", shares.size1(), columns), ca.MX.sym("shares", *shares.shape)
    w = ca.MX.sym("which", 1, which.numel())
    total = ca.jtimes(plain[:, w], plain, s, True)
    return ca.Function(ADD_CHOSEN, [w, s], [ca.densify(total)], STAYS_A_CALL)(
        ca.reshape(which, 1, -1), shares
    )
