"""Releases on a cluster: plan, apply, wait, record; independent of ROS and of Rigelfiles.

Importing this package costs nothing; `release`, `status` and `difference` hold what others call.
"""
