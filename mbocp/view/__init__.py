"""What a person sees: plots and replays.

`plots` and `replay` are the fronts; behind them stand `figures` (matplotlib) and `meshcat` with `meshes`.
"""
