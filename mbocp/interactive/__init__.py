"""A problem on a live page: its goal is dragged, its weights are turned, and it is solved again meanwhile."""

from mbocp.interactive.resolver import Wish
from mbocp.interactive.session import Live, live

__all__ = ["Live", "Wish", "live"]
