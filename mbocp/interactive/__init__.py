"""A problem on a live page: its goal is dragged, its weights are turned, and it is solved again meanwhile."""

from mbocp.interactive.session import Live, live
from mbocp.interactive.wish import Wish

__all__ = ["Live", "Wish", "live"]
