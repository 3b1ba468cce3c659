"""Collision geometry of a robot: the shapes of links, and spheres that cover them."""
