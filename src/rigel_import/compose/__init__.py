"""Docker Compose files as drafts of Rigelfiles.

reading.py    a file as a draft: its services with what they extend, what their nodes share
options.py    the keys of a service as options of a node
mounts.py     its volumes, devices and ports
service.py    a service with its environment and its ROS, and the node that it becomes
values.py     values of a file, with their places and with `${VARIABLE}` filled in
"""
