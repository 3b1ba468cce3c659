"""Limits between nodes: random problems, whose motions are sampled at 10 kHz along the robot's true flow."""
