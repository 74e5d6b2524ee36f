"""Programs that `inside.py` runs in a pod to read its ROS graph; they are sent with the request.

`ros1_graph.py` runs on any Python from 2.7, as the scripts in `inpod/`; `dds_graph.py` needs Python
3.9, like the exporter. Both print one JSON document.
"""
