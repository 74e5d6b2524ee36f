"""One ROS application: options, checks, the objects built from them (pure), and deploying it."""
