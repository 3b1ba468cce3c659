"""The compiled part, not public.

`_bridge` (Pinocchio with CasADi's scalar), `_kernel` (the numbers), `_nlp` (what helps interior-point
solvers), `_room` (clearances in numbers, and ways around obstacles).
"""
