"""One ROS application: options, checks, the objects they become (pure), and deploying it."""
