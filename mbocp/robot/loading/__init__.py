"""From a URDF, robot.toml or robot.yaml to a `Robot`."""
