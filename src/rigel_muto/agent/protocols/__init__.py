"""The three ways in which Muto's world gives commands, each without any I/O.

exchange    what they have in common: what arrives, and what can be answered
ros1        Muto's ROS 1 generation: commands as MQTT topics
ditto       its ROS 2 generation: live messages in Ditto's protocol
symphony    Eclipse Symphony's provider for targets behind MQTT
"""
