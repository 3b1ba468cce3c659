"""Exponential and logarithm on the joints' Lie groups, smooth where they are used, symbolic in CasADi."""

from mbocp.lie.configuration import ConfigurationSpace

__all__ = ["ConfigurationSpace"]
