"""What the commands do: what is seen and set of ROS in the running pods of a release."""
