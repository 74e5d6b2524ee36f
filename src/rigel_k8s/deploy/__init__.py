"""Releases on a cluster: plan, apply, wait, record; it knows nothing of ROS or Rigelfiles."""
