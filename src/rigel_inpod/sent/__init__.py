"""Programs that are sent into a pod with a request, to read its ROS graph there.

They are not mounted, so a pod that an older version deployed can be read by a newer one. They run
on any Python from 2.7 on, like the other scripts, and print one JSON document. What reads a DDS
graph is sent in the same way, from rigel_exporter.
"""
