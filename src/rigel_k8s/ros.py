"""Which ROS an application is, as plain facts; what differs in its pods is app/generation.py."""

from __future__ import annotations

import difflib
from collections.abc import Mapping
from datetime import date
from types import MappingProxyType

import attrs

from rigel_k8s.distros import DISTROS

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
