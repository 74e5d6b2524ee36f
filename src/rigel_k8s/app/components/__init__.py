"""The option `components` of a node: several ROS nodes that one process has loaded."""
