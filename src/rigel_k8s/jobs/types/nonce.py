"""How a nonce gets into a publisher's messages: a ROS parameter, set from inside its pod.

The publisher's image only needs Python, and rclpy for ROS 2, which its own
node may use too. The caller runs the commands; there is no access to a cluster here.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from typing import Any

from rigel_inpod import MOUNT_PATH
from rigel_k8s.generation import generation_of
from rigel_k8s.network.wiring import NETWORK_ANNOTATION
from rigel_k8s.objects.naming import ROS_NAME_ANNOTATION

#: A shell's exit code for a program that is not installed.
NO_PYTHON = 127

_ROS1 = """
import os, sys
try:
    from xmlrpc.client import ServerProxy
except ImportError:
    from xmlrpclib import ServerProxy
master = ServerProxy(os.environ["ROS_MASTER_URI"])
code, text, _ = master.setParam("/rigel_delivery", sys.argv[1], sys.argv[2])
sys.exit(0 if code == 1 else text)
"""

#: A parameter of ROS 2 is a node's own.
_ROS2 = """
import os, sys
import rclpy
from rcl_interfaces.srv import SetParameters
from rclpy.parameter import Parameter
owner, parameter, nonce = sys.argv[1:4]
rclpy.init(args=[])
node = rclpy.create_node("_rigel_delivery_%d" % os.getpid(), start_parameter_services=False,
                         enable_rosout=False)
client = node.create_client(SetParameters, owner + "/set_parameters")
if not client.wait_for_service(20):
    sys.exit("the node %s was not discovered within 20 s from inside its own pod" % owner)
wanted = Parameter(parameter, value=nonce).to_parameter_msg()
future = client.call_async(SetParameters.Request(parameters=[wanted]))
rclpy.spin_until_future_complete(node, future, timeout_sec=10)
if not future.done():
    sys.exit("the node %s did not answer within 10 s" % owner)
result = future.result().results[0]
sys.exit(0 if result.successful else "%s refused it: %s" % (owner, result.reason))
"""


def ros_of(pod: Mapping[str, Any], distro: str) -> str:
    """Return the ROS of a pod, "1" or "2": from its annotation, else that of `distro`."""
    note = pod["metadata"].get("annotations", {}).get(NETWORK_ANNOTATION)
    noted = json.loads(note).get("ros") if note else None
    return generation_of(distro, noted).name


def commands(
    pod: Mapping[str, Any], ros: str, parameter: str, nonce: str
) -> Sequence[Sequence[str]]:
    """Return the commands that set the parameter, to be tried while one ends with NO_PYTHON."""
    start = ["/bin/sh", f"{MOUNT_PATH}/exec.sh"]
    if ros == "1":
        return [[*start, p, "-c", _ROS1, parameter, nonce] for p in ("python3", "python")]
    owner = str(pod["metadata"].get("annotations", {}).get(ROS_NAME_ANNOTATION, ""))
    return [[*start, "python3", "-c", _ROS2, owner, parameter.lstrip("/"), nonce]]
