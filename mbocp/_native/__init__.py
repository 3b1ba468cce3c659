"""The compiled part: `_bridge` (Pinocchio with CasADi's scalar) and `_kernel` (numbers). Nothing here is public."""
