"""The ROS exporter: the state and traffic of a ROS graph, as metrics for Prometheus.

It is a separate program in an image of its own, beside an application's nodes. It only uses
Python's standard library and modules of rigel_inpod, for Python 3.9 and later, and is independent
of Kubernetes and of the other packages.

graph.py       the result of a look at a graph: plain data, the same for all
ros1*.py       ROS 1: master and slave APIs, TCPROS
ros2.py        ROS 2: asks the keepers of pods what its processes have noted
notes.py       these notes as a graph and as counters
dds*.py        DDS without ROS, and topics whose content is wanted: discovery, readers
messages.py    the few messages whose content becomes a metric, in both serializations
samples.py     what a named topic's subscriber has received
standing.py    compares looks with what is expected and was seen before, with limits
expecting.py   whether a topic is as expected
listening.py   named topics, /diagnostics, /clock, /tf
collection.py  looks in the background, and the answer to a scrape over HTTP
metrics.py     Prometheus' text, and the meaning of each metric
config.py      its configuration file
dds_graph.py   a program of its own, sent into a pod: the content of a DDS domain's discovery
"""

#: That of rigel_k8s, which is not in the image; a test compares them.
__version__ = "0.1.0"
