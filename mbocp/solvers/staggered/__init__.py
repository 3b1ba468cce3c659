"""Forward and backward sweeps: the gradient method and Newton's method on the controls."""
