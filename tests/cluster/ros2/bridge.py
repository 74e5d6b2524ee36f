#!/usr/bin/env python3
"""Stands in for foxglove_bridge: a node that sends one topic to viewers, by the same protocol.

It is mounted where the package's executable would be, and needs rclpy and the standard library.
"""

import base64
import hashlib
import json
import socketserver
import struct
import threading
import time

import rclpy
from std_msgs.msg import String

GUID = "258EAFA5-E914-47DA-95CA-C5AB0DC85B11"  # RFC 6455
PROTOCOL = "foxglove.sdk.v1"
TEXT, BINARY = 1, 2
MESSAGE_DATA = 1
CHANNEL = {
    "id": 1,
    "topic": "/chatter",
    "encoding": "cdr",
    "schemaName": "std_msgs/msg/String",
    "schema": "string data",
    "schemaEncoding": "ros2msg",
}


class Viewer(socketserver.StreamRequestHandler):
    """A viewer's connection."""

    def handle(self):
        headers = {}
        while line := self.rfile.readline().strip().decode():
            name, _, value = line.partition(": ")
            headers[name.lower()] = value
        if PROTOCOL not in headers.get("sec-websocket-protocol", ""):
            return
        accepted = hashlib.sha1((headers["sec-websocket-key"] + GUID).encode()).digest()
        self.wfile.write(
            b"HTTP/1.1 101 Switching Protocols\r\nUpgrade: websocket\r\nConnection: Upgrade\r\n"
            b"Sec-WebSocket-Protocol: %s\r\nSec-WebSocket-Accept: %s\r\n\r\n"
            % (PROTOCOL.encode(), base64.b64encode(accepted))
        )
        info = {"op": "serverInfo", "name": "stand-in", "capabilities": []}
        for message in (info, {"op": "advertise", "channels": [CHANNEL]}):
            self.send(TEXT, json.dumps(message).encode())
        request = json.loads(self.receive())
        (wanted,) = request["subscriptions"]
        assert (request["op"], wanted["channelId"]) == ("subscribe", CHANNEL["id"])
        head = struct.pack("<BIQ", MESSAGE_DATA, wanted["id"], time.time_ns())
        node.create_subscription(
            String, "/chatter", lambda cdr: self.send(BINARY, head + bytes(cdr)), 1, raw=True
        )
        self.rfile.read()

    def send(self, opcode, data):
        size = bytes([len(data)]) if len(data) < 126 else b"\x7e" + struct.pack("!H", len(data))
        self.wfile.write(bytes([128 | opcode]) + size + data)

    def receive(self):
        size = self.rfile.read(2)[1] & 127
        assert size < 126
        mask = self.rfile.read(4)
        return bytes(byte ^ mask[i % 4] for i, byte in enumerate(self.rfile.read(size)))


rclpy.init()
node = rclpy.create_node("stand_in")
port = node.declare_parameter("port", 0).value
server = socketserver.ThreadingTCPServer(("0.0.0.0", port), Viewer)
threading.Thread(target=server.serve_forever, daemon=True).start()
node.get_logger().info(f"listens at {port}")
rclpy.spin(node)
