"""The ROS exporter: the state and traffic of a ROS graph, as metrics for Prometheus.

It is a separate program in an image of its own, beside an application's nodes. It only uses
Python's standard library and inpod's scripts, for Python 3.9 and later, and is independent of
Kubernetes and of the rest of this package.

graph.py       the result of a look at a graph: plain data, the same for ROS 1 and DDS
ros1*.py       ROS 1: master and slave APIs, TCPROS
dds*.py        DDS: discovery, readers
standing.py    compares looks with what is expected and was seen before, with limits
listening.py   named topics, /diagnostics, /clock, /tf
collection.py  looks in the background, and the answer to a scrape
metrics.py     Prometheus' text, and the meaning of each metric
serving.py     HTTP
config.py      its configuration file
"""
