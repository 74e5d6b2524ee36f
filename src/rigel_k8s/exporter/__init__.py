"""The ROS exporter: what a ROS graph is and does, as metrics for Prometheus.

A program of its own that runs in an image of its own, beside an application's nodes. It stands on
Python's standard library and on inpod's scripts alone, for Python 3.9 and later, and knows nothing
of Kubernetes or of the rest of this package.

graph.py       what a look at a graph finds: plain data, the same for ROS 1 and DDS
ros1*.py       ROS 1: master and slave APIs, TCPROS
dds*.py        DDS: discovery, readers
standing.py    looks against what is expected and was seen before, bounded
listening.py   named topics, /diagnostics, /clock, /tf
collection.py  the looks in the background, and what a scrape gets
metrics.py     Prometheus' text, and what each metric means
serving.py     HTTP
config.py      the one file that tells it what to do
"""
