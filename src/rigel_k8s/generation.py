"""A ROS generation as one value: other code reads its fields instead of comparing its name.

Packages below `app/` read its plain fields; `app/` and those above call its functions. Each module
of app/generations/ defines one of them, imported on its first use, so this module knows only types.
"""

from __future__ import annotations

import difflib
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from datetime import date
from importlib import import_module
from typing import TYPE_CHECKING, Any, Literal

import attrs

from rigel_k8s.distros import DISTROS

if TYPE_CHECKING:
    from rigel_k8s.app.files import Folder
    from rigel_k8s.app.options import Component, NodeOptions, OrchestrationOptions
    from rigel_k8s.app.parameters import Fault, ParameterOptions
    from rigel_k8s.app.programs import Command
    from rigel_k8s.app.updating import Way
    from rigel_k8s.discovery.members import Member
    from rigel_k8s.kube.cluster import Cluster
    from rigel_k8s.network.options import Network
    from rigel_k8s.network.wiring import NetworkPlan, PodIdentity, Wiring
    from rigel_k8s.objects.podoptions import RollingUpdate, Volume
    from rigel_k8s.objects.refs import Manifest
    from rigel_k8s.objects.rosnames import Names
    from rigel_k8s.objects.workloads import ReleaseContext
    from rigel_k8s.problems import Path, Problem
    from rigel_k8s.release.types import ReleaseId
    from rigel_k8s.rosgraph.handover import GateStatus
    from rigel_k8s.rosgraph.pods import GraphPod
    from rigel_k8s.rosgraph.types import RosGraph

#: The words for it in a Rigelfile, in annotations and in the exporter's configuration.
Ros = Literal["1", "2", "none"]
Object = dict[str, Any]


@attrs.frozen(kw_only=True)
class Loading:
    """How a node loads components into its process.

    Attributes:
        script: the in-pod script beside the node that does it.
        describe: a component, by its key, for the script.
        check: what is wrong with a component; paths are its own.
        are_nodes: each is a node of its own in the ROS graph.
        twice: why two pods of a node must not load them at once; None: they may.
    """

    script: str
    describe: Callable[[str, Component], dict[str, Any]]
    check: Callable[[Component], Iterator[Problem]]
    are_nodes: bool
    twice: str | None = None


@attrs.frozen
class Texts:
    """What objects contain of files, by name.

    Attributes:
        scripts: the in-pod scripts; libraries: those that are loaded into ROS 2's processes.
        files: parameter files, by their names in the Rigelfile; folders: what nodes mount, too.
        program: that of the generation's companions.
    """

    scripts: Mapping[str, str] = attrs.field(factory=dict)
    files: Mapping[str, str] = attrs.field(factory=dict)
    program: Mapping[str, str] = attrs.field(factory=dict)
    libraries: Mapping[str, bytes] = attrs.field(factory=dict)
    folders: Mapping[str, Folder] = attrs.field(factory=dict)


@attrs.frozen(kw_only=True)
class Companion:
    """A workload that a release has beside its nodes.

    Attributes:
        title: what messages call it.
        objects: its objects, with the options that each comes from. They are made of the release,
            its texts, what the network adds, and where the nodes run (fields of the pod's spec).
        ros_name: that of the node in it, if the graph must have it.
    """

    identity: PodIdentity
    title: str
    objects: Callable[
        [ReleaseContext, Texts, Wiring, Mapping[str, Any]], Iterable[tuple[Path, Object]]
    ]
    ros_name: str | None = None


@attrs.frozen(kw_only=True, eq=False)
class Generation:
    """One way for programs to be nodes of a robot: ROS 1, ROS 2, or DDS without ROS.

    Attributes:
        name: the value of `ros`.
        title: what messages call an application of it.

        names: the names that its nodes may have, and remap.
        nodes: its programs are ROS nodes: they have names, and read arguments and variables of ROS.
        dds: they discover each other by DDS, or by zenoh in its place, not at a master.
        rmw: they read ROS 2's variables: the domain, the middleware, how far discovery reaches.
        lifecycle: a node may be a lifecycle node.
        prepares_home: a directory for logs is not created, but must be there with its owner.
        readiness: what makes a pod ready by default; None: a probe of ours.
        clash: what two nodes of one name do to each other.
        surge: the same during an update; None: programs have no names.
        hands_over: updates hand over where they can, without a request for it.

        program: what a node runs, with its own arguments; empty for the image's CMD. Raises
            ValueError for a line that cannot be split into words.
        takes_arguments: whether names, remappings and parameters can be appended to a line.
        command_of: what a container runs, by its key in `nodes` and the texts of parameter files.
        variables: ROS' own, by the ROS namespace of the node, and the field of the pod that has its
            address.
        volumes: (volume, mount) of what each pod has besides the in-pod scripts.
        probe: the words of the readiness probe.
        components: how a node loads components; None: it loads none.

        find_obstacle: why two pods of a node cannot run side by side, or nothing arbitrates between
            them; by the release's volumes, its network and its middleware.
        choose_way: how a workload is updated if the user does not set it: by its name, its ROS
            name, `update` and its obstacle.
        refuse_hand_over: why nothing of a job can be handed over, None if it can.

        check: what is wrong with the options of a job, beyond its nodes and its network.
        check_parameters: the same for parameters of a node or a job; paths are theirs.
        check_parameter_file: what is wrong with the text of a parameter file, of the node of a key,
            or None for one of the job.
        explain_unreadable: why a node does not read one of its options, None if it does.
        explain_unseen: why an exporter sees nothing of the graph, None if it sees it.

        in_context: a release's context with what its nodes connect to.
        companions: the workloads beside the nodes, by the options and the distribution.
        read_program: the files of its companions' programs, by name.
        bind: objects, with marks that restart pods when something changes that they read once.
        remedies: what to do if objects may not be written, by their kind.

        read_graph: the live graph, by the release's pods, their places in DDS, and the seconds for
            which rates are measured at most; 0 for no rates.
        read_gate: what arbitrates between nodes of one name; None: nothing does in this release.
        starter: the words of the Rigelfile that `rigel init` writes; empty if it writes none.
    """

    name: Ros
    title: str

    names: Names | None = None
    nodes: bool = True
    dds: bool = True
    rmw: bool = False
    lifecycle: bool = False
    prepares_home: bool = False
    readiness: str | None = None
    clash: str = ""
    surge: str | None = None
    hands_over: bool = False

    program: Callable[[NodeOptions], list[str]]
    takes_arguments: Callable[[Sequence[str]], bool] = lambda line: False
    command_of: Callable[[str, NodeOptions, Mapping[str, str]], Command]
    variables: Callable[[ReleaseContext, str | None, str], dict[str, Object]] = lambda *_: {}
    volumes: Callable[[], Sequence[tuple[Object, Object]]] = lambda: ()
    probe: Callable[[NetworkPlan], tuple[str, ...]]
    components: Loading | None = None

    find_obstacle: Callable[
        [NodeOptions, Mapping[str, Volume], Network | None, str | None], str | None
    ]
    choose_way: Callable[[ReleaseContext, str, str | None, RollingUpdate, str | None], Way]
    refuse_hand_over: Callable[[OrchestrationOptions, str], str | None] = lambda *_: None

    check: Callable[[OrchestrationOptions], Iterator[Problem]]
    check_parameters: Callable[[ParameterOptions], Iterator[Problem]] = lambda options: iter(())
    check_parameter_file: Callable[[str, str | None, ParameterOptions], Iterator[Fault]] = (
        lambda text, key, options: iter(())
    )
    explain_unreadable: Callable[[NodeOptions, str], str | None] = lambda node, key: None
    explain_unseen: Callable[[OrchestrationOptions], str | None]

    in_context: Callable[[ReleaseContext, OrchestrationOptions], ReleaseContext] = (
        lambda release, options: release
    )
    companions: Callable[[OrchestrationOptions, str], Sequence[Companion]] = lambda *_: ()
    read_program: Callable[[], Mapping[str, str]] = dict
    bind: Callable[[Sequence[Manifest]], Sequence[Manifest]] = lambda made: made
    remedies: Callable[[Sequence[Object]], Mapping[str, str]] = lambda made: {}

    read_graph: Callable[[Cluster, Sequence[GraphPod], Sequence[Member], float], RosGraph]
    read_gate: Callable[[Cluster, ReleaseId], GateStatus | None] = lambda *_: None
    starter: Mapping[str, str] = attrs.field(factory=dict)

    def of_node(self, node: NodeOptions) -> Generation:
        """Return the generation of one node: a program beside ROS nodes may have no ROS."""
        return GENERATIONS[node.ros] if node.ros else self


#: Each generation's module in app/generations/ and its name there. The first one is that of a
#: distribution that no one knows.
HOMES: Mapping[str, str] = {
    "1": "ros1:ROS1",
    "2": "ros2:ROS2",
    "none": "dds:DDS",
}


class Generations(Mapping[str, Generation]):
    """All generations by name."""

    def __getitem__(self, name: str) -> Generation:
        """Import a generation."""
        module, _, attribute = HOMES[name].partition(":")
        home = import_module(f"rigel_k8s.app.generations.{module}")
        generation: Generation = getattr(home, attribute)
        return generation

    def __iter__(self) -> Iterator[str]:
        """Yield the names."""
        return iter(HOMES)

    def __len__(self) -> int:
        """Return how many there are."""
        return len(HOMES)


GENERATIONS = Generations()


def generation_of(distro: str, chosen: str | None = None) -> Generation:
    """Return the generation of an application: the chosen one, else that of its distro."""
    known = (name for name in HOMES if distro.lower() in DISTROS.get(name, ()))
    return GENERATIONS[chosen or next(known, next(iter(HOMES)))]


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
