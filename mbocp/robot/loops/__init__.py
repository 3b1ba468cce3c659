"""Closed loops: holonomic constraints, their equations, projection on them, redundant rows."""
