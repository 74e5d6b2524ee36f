#!/usr/bin/env python3
"""router|talker|listener: sessions of zenoh's own, set up as those of rmw_zenoh.

ZENOH_CONFIG_OVERRIDE is rmw_zenoh's: KEY=VALUE pairs, parted by semicolons, values in JSON5.
"""

import os
import time

import words
import zenoh


def session():
    """Open a session; for as long as it takes where ZENOH_ROUTER_CHECK_ATTEMPTS is 0."""
    config = zenoh.Config()
    config.insert_json5("scouting/multicast/enabled", "false")
    if words.role() == "router":
        config.insert_json5("mode", '"router"')
    for pair in os.environ["ZENOH_CONFIG_OVERRIDE"].split(";"):
        key, _, value = pair.partition("=")
        config.insert_json5(key, value)
    while True:
        try:
            return zenoh.open(config)
        except zenoh.ZError as error:
            if os.environ.get("ZENOH_ROUTER_CHECK_ATTEMPTS") != "0":
                raise
            words.log(f"no router yet: {error}")
            time.sleep(1)


def main():
    """Route, say or hear, for ever."""
    with session() as opened:
        if words.role() == "listener":
            subscriber = opened.declare_subscriber("chatter")
            for sample in subscriber:
                words.heard(sample.payload.to_string())
        publisher = opened.declare_publisher("chatter")
        number = 0
        while True:
            number += 1
            if words.role() == "talker":
                publisher.put(words.greeting(number))
            time.sleep(0.2)


if __name__ == "__main__":
    main()
