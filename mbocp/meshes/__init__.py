"""Mesh files: STL, Collada, Wavefront OBJ and what coal reads, within limits; files may be hostile."""
