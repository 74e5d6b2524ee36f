#!/usr/bin/env python3
"""talker|listener: ROS 2's /chatter by Cyclone DDS alone, no ROS; plain-talker|plain-listener: a
topic and a type that are not ROS 2's.
"""

import os
import time
from dataclasses import dataclass

import words
from cyclonedds.core import Policy, Qos
from cyclonedds.domain import DomainParticipant
from cyclonedds.idl import IdlStruct
from cyclonedds.pub import DataWriter
from cyclonedds.sub import DataReader
from cyclonedds.topic import Topic
from cyclonedds.util import duration


@dataclass
class String(IdlStruct, typename="std_msgs::msg::dds_::String_"):
    """std_msgs/String, as ROS 2 has it on the wire."""

    data: str


@dataclass
class Greeting(IdlStruct, typename="Plain::Greeting"):
    """A type of an application that knows nothing of ROS."""

    number: int
    data: str


def main():
    """Say or hear, for ever."""
    plain = words.role().startswith("plain-")
    quality = Qos(Policy.Reliability.Reliable(duration(seconds=1)), Policy.History.KeepLast(10))
    participant = DomainParticipant(int(os.environ.get("ROS_DOMAIN_ID", "0")))
    name, kind = ("Greetings", Greeting) if plain else ("rt/chatter", String)
    topic = Topic(participant, name, kind, qos=quality)
    if words.role().endswith("listener"):
        return listen(DataReader(participant, topic, qos=quality))
    return talk(DataWriter(participant, topic, qos=quality), plain)


def talk(writer, plain):
    """Greet five times a second."""
    number = 0
    while True:
        number += 1
        text = words.greeting(number)
        writer.write(Greeting(number=number, data=text) if plain else String(data=text))
        time.sleep(0.2)


def listen(reader):
    """Log each greeting."""
    while True:
        for sample in reader.take(100):
            if text := getattr(sample, "data", None):  # else the end of a writer
                words.heard(text)
        time.sleep(0.02)


if __name__ == "__main__":
    main()
