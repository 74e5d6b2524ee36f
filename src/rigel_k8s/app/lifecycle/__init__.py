"""The option `lifecycle` of a node of ROS 2: transitions at its start and end."""
