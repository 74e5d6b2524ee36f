"""Loads composable nodes into the container that runs in this pod: ROS 2's `components`.

Why: `ros2 launch` continues without a component that cannot be loaded, and only its log shows it.
This script calls the component container itself, which answers with the reason.

    components.py FILE

Contract: FILE is JSON, {"node": CONTAINER, "components": [{"name", "package", "plugin",
"parameters", "remappings", "extra_arguments"}]}; node and names are full ROS names, parameters have
the names that ROS 2 gives them, remappings are rules. The script ends when all components are
loaded (loading.py). It runs in the node's own environment, with its rclpy and
composition_interfaces, which every image with rclcpp_components has.
"""

import os
import sys
import time

from loading import NotYet, Refused, load_file

ANSWER = 2.0  # seconds that the container has to list what it has loaded
SLICE = 0.2  # seconds between two chances for a signal to be handled


class Container(object):
    """The component container, called by a hidden ROS node.

    Attributes:
        loaded: the full names of the nodes that it has.
    """

    def __init__(self, name):
        """`name` is its full ROS name."""
        import rclpy
        from composition_interfaces.srv import ListNodes, LoadNode
        from rclpy.parameter import Parameter

        rclpy.init(args=[], signal_handler_options=rclpy.signals.SignalHandlerOptions.NO)
        self.loaded, self._spin = [], rclpy.spin_once
        self._parameter, self._list, self._load = Parameter, ListNodes, LoadNode
        self.node = rclpy.create_node(
            "_rigel_k8s_components_%d" % os.getpid(),
            enable_rosout=False,
            start_parameter_services=False,
        )
        self.list_client = self.node.create_client(ListNodes, name + "/_container/list_nodes")
        self.load_client = self.node.create_client(LoadNode, name + "/_container/load_node")

    def find(self):
        """List what is loaded: a container that was lost may be visible and yet not answer."""
        for client in (self.list_client, self.load_client):
            if not client.service_is_ready():
                self._spin(self.node, timeout_sec=SLICE)
                raise NotYet("%s is not there" % client.srv_name)
        answer = self._ask(self.list_client, self._list.Request(), ANSWER)
        if answer is None:
            raise NotYet("%s does not answer" % self.list_client.srv_name)
        self.loaded = list(answer.full_node_names)

    def load(self, component):
        """Load a component that is missing; raise Refused if the container refuses."""
        if component["name"] in self.loaded:
            return
        answer = self._ask(self.load_client, self._request(component))
        if not answer.success:
            raise Refused(answer.error_message)

    def _request(self, component):
        namespace, _, name = component["name"].rpartition("/")
        request = self._load.Request()
        request.package_name, request.plugin_name = component["package"], component["plugin"]
        request.node_name, request.node_namespace = name, namespace or "/"
        request.remap_rules = component["remappings"]
        request.parameters = self._messages(component["parameters"])
        request.extra_arguments = self._messages(component["extra_arguments"])
        return request

    def _messages(self, values):
        found = sorted(values.items())
        return [self._parameter(name, value=value).to_parameter_msg() for name, value in found]

    def _ask(self, client, request, seconds=None):
        """Return a service's answer, None if it has not arrived in time; a load may take long."""
        future, until = client.call_async(request), time.time() + (seconds or 0)
        while not future.done():
            if seconds and time.time() > until:
                client.remove_pending_request(future)
                return None
            self._spin(self.node, timeout_sec=SLICE)
        return future.result()


if __name__ == "__main__":
    load_file(sys.argv[1], Container)
