"""Lower bounds of durations and costs: how much better a motion could be at most."""
