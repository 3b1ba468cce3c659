"""A scene in viser, whose motion changes while it is watched."""
