"""Natural coordinates: every body by its position and the nine numbers of its axes."""
