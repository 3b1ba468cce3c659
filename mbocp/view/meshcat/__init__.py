"""A motion in meshcat: scene, self-contained page, live page."""
