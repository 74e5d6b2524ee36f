"""Configures and activates lifecycle nodes: manager.py NODE...; says `managed` when all are active.

As Nav2's manager, it calls each node once, and gives up if a transition is refused.
"""

import os
import sys
from contextlib import suppress

import rclpy
from lifecycle_msgs.msg import Transition
from lifecycle_msgs.srv import ChangeState
from rclpy.executors import ExternalShutdownException

rclpy.init()
node = rclpy.create_node("manager")
with suppress(KeyboardInterrupt, ExternalShutdownException):
    for name in sys.argv[1:]:
        if name.startswith("--"):
            break
        client = node.create_client(ChangeState, f"{name}/change_state")
        while not client.wait_for_service(timeout_sec=1):
            pass
        for number in (Transition.TRANSITION_CONFIGURE, Transition.TRANSITION_ACTIVATE):
            request = ChangeState.Request(transition=Transition(id=number))
            call = client.call_async(request)
            rclpy.spin_until_future_complete(node, call)
            if not call.result().success:
                sys.exit(f"{name} refused transition {number}")
    print(os.environ["VERSION"], "managed", flush=True)  # noqa: T201
    rclpy.spin(node)
