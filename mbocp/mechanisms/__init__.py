"""Mechanisms with closed loops: consistent states, completion of partial ones, closed paths, and search."""
