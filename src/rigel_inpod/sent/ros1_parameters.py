"""The parameters of the ROS master, as one line of JSON. Python 2.7 and 3.

    ros1_parameters.py [NAME]
    ros1_parameters.py NAME VALUE [NAME VALUE]...

Contract: without a name "names" has those of all parameters. With one "value" is its value, in the
types that XML-RPC has; it is missing if the parameter does not exist. VALUE is JSON: parameters are
set, and the answer is empty. "error" is the reason why the
master did not answer.
"""

import json
import os
import socket
import sys

try:
    from xmlrpc import client
except ImportError:
    import xmlrpclib as client

CALLER = "/rigel_k8s"
ANSWER = 5.0  # seconds


def look(uri, words):
    """Return parameters of the master at this URI, or set them."""
    master = client.ServerProxy(uri)
    if not words:
        return {"names": sorted(master.getParamNames(CALLER)[2])}
    if len(words) > 1:
        for name, value in zip(words[::2], words[1::2]):
            master.setParam(CALLER, name, json.loads(value))
        return {}
    code, _, value = master.getParam(CALLER, words[0])
    return {"value": value} if code == 1 else {}


def main(words):
    """Print it."""
    uri = os.environ.get("ROS_MASTER_URI", "http://localhost:11311")
    socket.setdefaulttimeout(ANSWER)
    try:
        found = look(uri, words)
    except Exception as error:
        found = {"error": "the ROS master at %s does not answer: %s" % (uri, error)}
    sys.stdout.write(json.dumps(found, default=str) + "\n")


if __name__ == "__main__":
    main(sys.argv[1:])
