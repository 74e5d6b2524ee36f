"""How many messages per second the ROS exporter receives of each topic, as one line of JSON.

    heard.py PORT

Why: Prometheus has rates of minutes, which still contain the gap of an update; the exporter's own
counters, read twice, show the present rate. It runs in the exporter's pod. Contract: {topic: rate}.
"""

from __future__ import annotations

import json
import re
import sys
import time
import urllib.request

SPAN = 2.5  # seconds between two readings
ANSWER = 5.0  # seconds that the exporter has for an answer
COUNTER = re.compile(r'^ros_topic_messages_total\{topic="([^"]*)"\} (\d+)$', re.MULTILINE)


def read(port: str) -> tuple[float, dict[str, int]]:
    """Return the time, and the messages that were received of each topic."""
    url = f"http://127.0.0.1:{port}/metrics"
    with urllib.request.urlopen(url, timeout=ANSWER) as answer:
        text = answer.read().decode()
    return time.monotonic(), {topic: int(count) for topic, count in COUNTER.findall(text)}


def main(port: str) -> None:
    """Print the rates; "error" is the reason why there are none."""
    try:
        began, first = read(port)
        time.sleep(SPAN)
        ended, second = read(port)
    except OSError as error:
        sys.stdout.write(json.dumps({"error": f"the ROS exporter does not answer: {error}"}) + "\n")
        return
    grown = {topic: second[topic] - count for topic, count in first.items() if topic in second}
    rates = {topic: more / (ended - began) for topic, more in grown.items() if more >= 0}
    sys.stdout.write(json.dumps(rates, sort_keys=True) + "\n")


if __name__ == "__main__":
    main(sys.argv[1])
