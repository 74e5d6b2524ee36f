"""Docker Compose files as drafts of Rigelfiles.

reading.py    a file as a draft: what the nodes share, and what each service becomes
options.py    the keys of a service as options of a node
mounts.py     its volumes, devices and ports
programs.py   what it runs
service.py    a service with its environment and its ROS, and the node that it becomes
files.py      the services of a file, with what they extend
values.py     values of a file, with their places and with `${VARIABLE}` filled in
"""
