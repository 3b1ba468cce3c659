"""Result files as bytes: what is in them, how they are sealed, and how they are read with care.

This layer knows HDF5 and nothing of solutions, so that the process which guards old files starts fast.
"""
