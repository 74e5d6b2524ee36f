"""What ROS 1, ROS 2 and DDS without ROS do differently in an application: one class for each.

Their classes are in app/generations/, and are imported on their first use.
"""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from typing import Any, ClassVar

import attrs

from rigel_k8s.app.command import Command
from rigel_k8s.app.files import Folder
from rigel_k8s.app.options import Component, NodeOptions, OrchestrationOptions
from rigel_k8s.app.parameters import Fault, ParameterOptions
from rigel_k8s.app.updating import Candidate, Way, is_rolling
from rigel_k8s.network.options import Network
from rigel_k8s.network.wiring import PodIdentity, Wiring
from rigel_k8s.objects.podoptions import Volume
from rigel_k8s.objects.pods import Object
from rigel_k8s.objects.refs import Manifest
from rigel_k8s.objects.rosnames import Names
from rigel_k8s.objects.workloads import ReleaseContext
from rigel_k8s.problems import Path, Problem
from rigel_k8s.ros import Ros, name_of_distro
from rigel_k8s.system.lazily import Lazily


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


@attrs.frozen(kw_only=True)
class Generation(Ros):
    """A ROS with all that differs; what most have in common is the default.

    Attributes:
        names: the names that its nodes may have, and remap; None for programs without names.
        lifecycle: a node may be a lifecycle node.
        clash: what two nodes of one name do to each other.
        surge: the same during an update; None: programs have no names.
        components: how a node loads components; None: it loads none.
        starter: the words of the Rigelfile that `rigel init` writes; empty if it writes none.
    """

    names: ClassVar[Names | None] = None
    lifecycle: ClassVar[bool] = False
    clash: ClassVar[str] = ""
    surge: ClassVar[str | None] = None
    components: ClassVar[Loading | None] = None
    starter: ClassVar[Mapping[str, str]] = {}

    @classmethod
    def of(cls, ros: Ros) -> Generation:
        return cls(**{field.name: getattr(ros, field.name) for field in attrs.fields(Ros)})

    def of_node(self, node: NodeOptions) -> Generation:
        """Return the generation of one node: a program beside ROS nodes may have no ROS."""
        return GENERATIONS[node.ros] if node.ros else self

    # The container of a node.

    @abstractmethod
    def program(self, node: NodeOptions) -> list[str]:
        """Return what a node runs, with its own arguments; empty for the image's CMD.

        Raises:
            ValueError: a line cannot be split into words.
        """

    def find_program(self, node: NodeOptions) -> list[str]:
        """Return what a node runs; empty for an invalid command line, which others report."""
        try:
            return self.program(node)
        except ValueError:
            return []

    def takes_arguments(self, line: Sequence[str]) -> bool:
        """Whether names, remappings and parameters can be appended to a line."""
        return False

    @abstractmethod
    def command_of(self, key: str, node: NodeOptions, files: Mapping[str, str]) -> Command:
        """Return what a node's container runs.

        Args:
            key: the node's key in `nodes`.
            files: the texts of its parameter files, by the names in `parameter_files`.
        """

    def variables(
        self, release: ReleaseContext, namespace: str | None, address: str
    ) -> dict[str, Object]:
        """Return ROS' own variables of a container.

        Args:
            namespace: the ROS namespace of the node.
            address: the field of the pod that has its address.
        """
        return {}

    # Updates.

    def find_obstacle(
        self,
        node: NodeOptions,
        volumes: Mapping[str, Volume],
        network: Network | None,
        middleware: str | None,
    ) -> str | None:
        """Return why two pods of a node cannot run side by side, or nothing arbitrates."""
        return None

    def choose_way(
        self, candidate: Candidate, *, anonymous: bool = False, exclusive: str | None = None
    ) -> Way:
        """Return how a workload is updated.

        Args:
            exclusive: why one machine cannot run two of its pods; see updating.find_exclusive.
        """
        asked = candidate.update
        if is_rolling(asked):
            return Way("Rolling", "`update` requests it", asked)
        if asked.strategy is not None and asked.strategy.lower() == "recreate":
            return Way("Recreate", "`update` requests it", asked)
        if anonymous and exclusive:
            return Way("Recreate", exclusive, asked)
        if anonymous:
            return Way("Rolling", "its ROS name differs in each pod", asked)
        return self.hand_over(candidate)

    def hand_over(self, candidate: Candidate) -> Way:
        """Return HandOver where it works, with what pods need for it; else why not."""
        return Way("Recreate", "nothing arbitrates between two programs")

    @abstractmethod
    def refuse_hand_over(self, options: OrchestrationOptions, distro: str) -> str | None:
        """Return why nothing of a job can be handed over, None if it can."""

    # Checks.

    @abstractmethod
    def check(self, options: OrchestrationOptions) -> Iterator[Problem]:
        """Yield what is wrong with the options of a job, beyond its nodes and its network."""

    def check_parameters(self, options: ParameterOptions) -> Iterator[Problem]:
        """Yield what is wrong with parameters of a node or a job; paths are theirs."""
        return iter(())

    def check_parameter_file(
        self, text: str, key: str | None, options: ParameterOptions
    ) -> Iterator[Fault]:
        """Yield what is wrong with the text of a parameter file.

        Args:
            key: its node's; None for a file of the job.
        """
        return iter(())

    def explain_unreadable(self, node: NodeOptions, key: str) -> str | None:
        """Return why a node does not read one of its options, None if it does."""
        return None

    @abstractmethod
    def explain_unseen(self, options: OrchestrationOptions) -> str | None:
        """Return why an exporter sees nothing of the graph, None if it sees it."""

    # What a release has beside its nodes: roscore, in ROS 1.

    def in_context(self, release: ReleaseContext, options: OrchestrationOptions) -> ReleaseContext:
        """Return a release's context with what its nodes connect to."""
        return release

    def companions(self, options: OrchestrationOptions, distro: str) -> Sequence[Companion]:
        """Return the workloads beside the nodes."""
        return ()

    def read_program(self) -> Mapping[str, str]:
        """Return the files of its companions' programs, by name."""
        return {}

    def bind(self, made: Sequence[Manifest]) -> Sequence[Manifest]:
        """Return objects with marks that restart pods when what they read once has changed."""
        return made

    def remedies(self, made: Sequence[Object]) -> Mapping[str, str]:
        """Return what to do if objects may not be written, by their kind."""
        return {}


_HOME = "rigel_k8s.app.generations"
GENERATIONS: Mapping[str, Generation] = Lazily(
    {"1": f"{_HOME}.ros1:ROS1", "2": f"{_HOME}.ros2:ROS2", "none": f"{_HOME}.dds:DDS"}
)


def generation_of(distro: str, chosen: str | None = None) -> Generation:
    """Return the generation of an application: the chosen one, else that of its distro."""
    return GENERATIONS[chosen or name_of_distro(distro)]
