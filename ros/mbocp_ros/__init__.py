"""A ROS 2 node that moves an arm by mbocp: optimal motions within limits, and stops of them."""
