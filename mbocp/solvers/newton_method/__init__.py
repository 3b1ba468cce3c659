"""Newton's method on the whole horizon: direction, limits, line search, shift, stop."""
