"""Optima as functions that JAX and PyTorch differentiate."""
