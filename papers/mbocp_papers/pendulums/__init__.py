"""The first paper reproduced: its Tables 1 to 7, and its Figures 2, 3, 4, 6, 7, 8.

    from mbocp_papers.pendulums import make_table
    print(make_table(2, quick=True).markdown())

`mbocp paper` prints and draws all of them.
"""

from mbocp_papers.layout import PaperTable
from mbocp_papers.pendulums.tables import make_table

__all__ = ["PaperTable", "make_table"]
