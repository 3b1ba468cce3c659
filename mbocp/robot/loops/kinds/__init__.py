"""One file for each kind of holonomic constraint; `mbocp.robot.loops.constraints` has the list of them."""
