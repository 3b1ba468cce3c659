"""Menus: several local optima of one problem, each with a name."""
