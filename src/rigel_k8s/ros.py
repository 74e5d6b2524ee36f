"""Which ROS an application is, as plain facts; what differs in its pods is app/generation.py."""

from __future__ import annotations

import difflib
from collections.abc import Mapping
from datetime import date
from types import MappingProxyType

import attrs

#: noetic is the last one.
DISTROS_1: Mapping[str, date] = MappingProxyType(
    {
        "noetic": date(2025, 5, 31),
        "melodic": date(2023, 5, 30),
        "lunar": date(2019, 5, 31),
        "kinetic": date(2021, 4, 30),
        "jade": date(2017, 5, 31),
        "indigo": date(2019, 4, 30),
        "hydro": date(2015, 5, 31),
    }
)
#: rolling has no end.
DISTROS_2: Mapping[str, date] = MappingProxyType(
    {
        "lyrical": date(2031, 5, 31),
        "kilted": date(2026, 12, 31),
        "jazzy": date(2029, 5, 31),
        "iron": date(2024, 12, 4),
        "humble": date(2027, 5, 31),
        "galactic": date(2022, 12, 9),
        "foxy": date(2023, 6, 20),
        "eloquent": date(2020, 11, 30),
        "dashing": date(2021, 5, 31),
        "crystal": date(2019, 12, 31),
        "bouncy": date(2019, 7, 31),
        "ardent": date(2018, 12, 31),
        "rolling": date.max,
    }
)
#: The present distribution with the longest support.
CURRENT = "lyrical"

#: By the generation that they are of.
DISTROS: Mapping[str, Mapping[str, date]] = {"1": DISTROS_1, "2": DISTROS_2}

#: What begins the arguments that ROS 2 reads from a command line, and what ends them.
ROS_ARGS, ROS_ARGS_END = "--ros-args", "--"


@attrs.frozen(kw_only=True)
class Ros:
    """ROS 1, ROS 2, or DDS without ROS.

    Attributes:
        name: the word for it in a Rigelfile (`ros`), in annotations and for the exporter.
        title: what messages call an application of it.
        nodes: its programs are ROS nodes: they have names, and read arguments and variables of ROS.
        dds: they discover each other by DDS, or by zenoh in its place, not at a master.
        rmw: they read ROS 2's variables: the domain, the middleware, how far discovery reaches.
        logs: they write logs into a directory that their pods get.
        readiness: what makes a pod ready by default; None: a probe of ours.
        hands_over: updates hand over where they can, without a request for it.
        prepares_home: a directory for logs is not created, but must be there with its owner.
    """

    name: str
    title: str
    nodes: bool = True
    dds: bool = True
    rmw: bool = False
    logs: bool = False
    readiness: str | None = None
    hands_over: bool = False
    prepares_home: bool = False


ROS_1 = Ros(name="1", title="ROS 1", dds=False, hands_over=True, prepares_home=True)
ROS_2 = Ros(name="2", title="ROS 2", rmw=True, logs=True, hands_over=True)
NO_ROS = Ros(name="none", title="a plain DDS application", nodes=False, readiness="none")
#: By name. The first one is that of a distribution that no one knows, and of pods without a note.
BY_NAME: Mapping[str, Ros] = MappingProxyType({one.name: one for one in (ROS_1, ROS_2, NO_ROS)})


def name_of_distro(distro: str) -> str:
    """Return the name of a distribution's ROS."""
    known = (name for name in BY_NAME if distro.lower() in DISTROS.get(name, ()))
    return next(known, next(iter(BY_NAME)))


def guess_distro(distro: str) -> str | None:
    """Return the distribution that an unknown name was probably meant to be."""
    known = sorted(name for names in DISTROS.values() for name in names)
    if distro.lower() in known:
        return None
    return next(iter(difflib.get_close_matches(distro.lower(), known, n=1, cutoff=0.7)), None)


def find_end(distro: str, today: date) -> date | None:
    """Return the last day of a distribution's support if it is over.

    noetic has none: there is no newer ROS 1 to move to.
    """
    ends = {name: end for names in DISTROS.values() for name, end in names.items()}
    end = (ends | {"noetic": date.max}).get(distro.lower(), date.max)
    return end if end < today else None
