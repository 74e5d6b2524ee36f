"""muto agent: commands of Eclipse Muto, carried out on one release.

What MQTT says and hears is in muto/agent/; here it meets the Rigelfile and the cluster.

serving        the program: the broker on one side, an executor on the other
executor       commands in, outcomes out; what is remembered and announced
application    the release that commands deploy: a Rigelfile's job with another stack
questions      answers about the ROS graph, in Muto's shapes
"""
