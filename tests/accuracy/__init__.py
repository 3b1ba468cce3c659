"""How far motions are from the robot."""
