"""Plots and replays of a solution.

`plots` and `replay` are the fronts; behind them stand `figures` (matplotlib) and `meshcat` with `meshes`.
"""
