"""ROS 1, ROS 2 and DDS without ROS: a module each with its value, listed in generation.py."""
