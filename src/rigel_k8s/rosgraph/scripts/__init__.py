"""Programs that `inside.py` runs in a pod to read its ROS graph; they travel with the request.

`ros1_graph.py` runs on any Python from 2.7, as the scripts in `inpod/`; `dds_graph.py` needs what
the exporter needs, Python 3.9. Both print one JSON document.
"""
