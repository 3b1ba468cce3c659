"""Poses of frames, and the configurations that reach them: inverse kinematics."""
