"""Loads nodelets into the manager that runs in this container: ROS 1's `components`.

Why: `nodelet load` would be a process of its own for each nodelet, registered with the master
before it has loaded anything, so a pod would be ready although a nodelet is missing. This script
calls the manager itself, which answers whether it has loaded a nodelet.

    nodelets.py FILE

Contract: FILE is JSON, {"node": MANAGER, "components": [{"name", "plugin", "parameters",
"remappings"}]}; all ROS names are full ones. A nodelet's parameters replace those under its name.
The script ends when all are loaded (loading.py). A manager counts only if it listens in this
container: while a pod is replaced, the master may have the old pod's under this name. Environment:
ROS_MASTER_URI, ROS_IP, ROS_HOSTNAME. Python 2.7 and 3, nothing but the standard library.
"""

import os
import socket
import struct
import sys
import time

try:
    from xmlrpc.client import ServerProxy
except ImportError:  # Python 2
    from xmlrpclib import ServerProxy

from container import Listeners
from loading import NotYet, Refused, load_file
from rosrpc import Api, CallFailed, split

CALLER = "/rigel_nodelet_loader"
ANSWER = 8.0  # seconds that the master has to answer


class Manager(object):
    """The manager that loads; `place` is the address of its service."""

    def __init__(self, name):
        self.service = name + "/load_nodelet"
        self.place = None

    def find(self):
        """Find the service in this container; raise NotYet if it is not there."""
        master = Api(os.environ.get("ROS_MASTER_URI", ""), time.time() + ANSWER)
        try:
            code, _, uri = master.call("lookupService", self.service)
            master.close()
            if code != "1":
                raise NotYet("the ROS master has no service %s" % self.service)
            host, port = split(uri.replace("rosrpc://", "http://"))
        except CallFailed as error:
            raise NotYet("cannot reach the ROS master: %s" % error)
        own = os.environ.get("ROS_HOSTNAME") or os.environ.get("ROS_IP") or os.uname()[1]
        if host != own or port not in Listeners().pids:
            raise NotYet("the ROS master has %s of another pod, at %s" % (self.service, uri))
        self.place = host, port

    def load(self, component):
        """Load a nodelet; raise Refused if the manager refuses."""
        try:
            self.set_parameters(component)
            call(self.place, self.service, make_request(component))
        except (CallFailed, EnvironmentError) as error:
            raise NotYet(str(error))

    def set_parameters(self, component):
        """Set a nodelet's private parameters; without any the master keeps what it has."""
        if component["parameters"]:
            master = ServerProxy(os.environ["ROS_MASTER_URI"])
            try:
                master.setParam(CALLER, component["name"], component["parameters"])
            except Exception as error:  # xmlrpc and http have no class of errors in common
                raise NotYet("parameters of %s cannot be set: %s" % (component["name"], error))


def make_request(component):
    """Return a request of nodelet/NodeletLoad, as it is sent."""
    renamed = sorted(component["remappings"].items())
    return b"".join(
        [
            pack_text(component["name"]),
            pack_text(component["plugin"]),
            pack_list([one for one, _ in renamed]),
            pack_list([other for _, other in renamed]),
            pack_list([]),  # the nodelet's own arguments
            pack_text(""),  # no bond: the manager ends with its container
        ]
    )


def pack_text(text):
    """Return a string as ROS serialises it."""
    data = text.encode("utf-8")
    return struct.pack("<I", len(data)) + data


def pack_list(texts):
    """Return a list of strings as ROS serialises it."""
    return struct.pack("<I", len(texts)) + b"".join(pack_text(text) for text in texts)


def call(place, service, request):
    """Call a service whose answer is one `bool success`; raise Refused if it is not True.

    A nodelet may take its time, so there is no time limit.
    """
    connection = socket.create_connection(place, ANSWER)
    try:
        connection.settimeout(None)
        fields = ("callerid=" + CALLER, "md5sum=*", "service=" + service)
        header = b"".join(pack_text(field) for field in fields)
        connection.sendall(struct.pack("<I", len(header)) + header)
        receive_block(connection)  # the service's own header
        connection.sendall(struct.pack("<I", len(request)) + request)
        is_answered = receive(connection, 1) != b"\0"
        answer = receive_block(connection)
    finally:
        connection.close()
    if not is_answered:
        raise Refused(answer.decode("utf-8", "replace"))
    if answer[:1] != b"\1":
        raise Refused("")


def receive_block(connection):
    """Return a block whose length comes first."""
    return receive(connection, struct.unpack("<I", receive(connection, 4))[0])


def receive(connection, count):
    """Return exactly so many bytes."""
    data = b""
    while len(data) < count:
        more = connection.recv(count - len(data))
        if not more:
            raise CallFailed("it has closed the connection")
        data += more
    return data


if __name__ == "__main__":
    load_file(sys.argv[1], Manager)
