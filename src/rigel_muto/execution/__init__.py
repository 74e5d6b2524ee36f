"""muto agent: executes commands of Eclipse Muto on one release.

The MQTT protocol is in muto/agent/; here it is joined with the Rigelfile and the cluster.

serving        the program: the broker on one side, an executor on the other
executor       commands in, outcomes out; what is stored and announced
application    the release that commands deploy: a Rigelfile's job with another stack
questions      answers about the ROS graph, in Muto's shapes
"""
