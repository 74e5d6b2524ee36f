"""The live graph of a release's ROS nodes, as far as it joins a deploy.

It stands above `rigel_k8s`, which never imports this package; what it adds is found by entry points
(pyproject.toml).

guest.py   what joins a deploy; hooks.py: what is done around it
"""
