"""Where a motion ends and begins: goals, their completion, cycles, free starts."""
