"""From the name of a method to an outcome: phases, fallbacks, other processes."""
