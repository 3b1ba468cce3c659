"""A stagewise programme as one sparse nonlinear programme, for interior-point solvers behind CasADi."""
