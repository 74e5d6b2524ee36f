"""The option `components` of a node: several ROS nodes in one process."""
