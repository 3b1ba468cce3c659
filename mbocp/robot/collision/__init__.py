"""Collision geometry of a robot: the shapes of the URDF, and spheres that cover them."""
