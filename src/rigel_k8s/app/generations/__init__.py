"""ROS 1, ROS 2 and DDS without ROS: a class each, listed in app/generation.py."""
