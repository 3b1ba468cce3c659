"""Mesh files: STL, Collada and Wavefront OBJ, their materials and pictures."""
