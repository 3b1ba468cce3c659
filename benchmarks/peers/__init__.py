"""The same problems by mbocp and by others, in one run: `python -m benchmarks.peers` (or `make bench-peers`).

Problems are the files in `problems/`. Each solver has a process and an environment of its own, gets the same
model, discretisation (semi-implicit Euler) and start (x_k = x_0, gravity compensated), and hands back its
trajectory, which `judge` evaluates with Pinocchio alone. What runs outside of mbocp's environment (`task`,
`judge`, `tools/crocoddyl_ddp`, `tools/mim_csqp`) imports nothing of mbocp.
"""
