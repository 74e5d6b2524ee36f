"""Sends the worker one goal of so many seconds and prints how it ended: goal.py SECONDS."""

import sys

import rclpy
from rclpy.action import ActionClient
from test_msgs.action import Fibonacci

NUMBER = 900
rclpy.init()
node = rclpy.create_node("goal")
client = ActionClient(node, Fibonacci, "reach")
if not client.wait_for_server(timeout_sec=30):
    sys.exit("no server")
order = NUMBER * 1000 + int(float(sys.argv[1]) * 10)
sent = client.send_goal_async(Fibonacci.Goal(order=order))
rclpy.spin_until_future_complete(node, sent)
print("accepted" if sent.result().accepted else "refused", flush=True)  # noqa: T201
answer = sent.result().get_result_async()
rclpy.spin_until_future_complete(node, answer)
print("status", answer.result().status, "by", answer.result().result.sequence)  # noqa: T201
