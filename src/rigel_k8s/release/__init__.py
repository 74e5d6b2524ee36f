"""Releases on a cluster: plan, apply, wait, record; it knows nothing of ROS or Rigelfiles.

Importing this package is free; `release`, `status` and `difference` hold what others call.
"""
