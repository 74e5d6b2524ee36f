"""The job that checks that messages are delivered, now, from one pod to another.

Two ready pods do not prove it: a subscriber may be deaf, or hear an older publisher. So a
nonce is set as a ROS parameter from inside the publisher's pod (ROS 2: of its own node), and
searched for in the subscriber's log. The publisher's image only needs Python, and rclpy for ROS 2.
"""

from __future__ import annotations

import json
import re
import secrets
import threading
from collections.abc import Iterable, Iterator, Mapping, Sequence
from typing import Any, ClassVar

import attrs

from rigel_inpod import MOUNT_PATH
from rigel_k8s.app.generation import generation_of
from rigel_k8s.errors import Interrupted, RigelK8sError
from rigel_k8s.jobs.job import JobContext
from rigel_k8s.kube import connect
from rigel_k8s.kube.cluster import Cluster
from rigel_k8s.network.wiring import NETWORK_ANNOTATION
from rigel_k8s.objects.facts import stays_ready
from rigel_k8s.objects.marks import NAME_LABEL
from rigel_k8s.objects.naming import ROS_NAME_ANNOTATION, object_name
from rigel_k8s.objects.podnodes import split_all
from rigel_k8s.objects.scalars import Count, Duration, ObjectName, RosName
from rigel_k8s.problems import Problem
from rigel_k8s.release.pods import list_pods
from rigel_k8s.release.types import ReleaseId
from rigel_k8s.settings import Application

#: Seconds between two looks for a ready pod.
LOOK = 1.0
#: A shell's exit code for a program that is not installed.
NO_PYTHON = 127

_ROS1 = """
import os, sys
try:
    from xmlrpc.client import ServerProxy
except ImportError:
    from xmlrpclib import ServerProxy
master = ServerProxy(os.environ["ROS_MASTER_URI"])
code, text, _ = master.setParam("/rigel_delivery", sys.argv[1], sys.argv[2])
sys.exit(0 if code == 1 else text)
"""

#: A parameter of ROS 2 is a node's own.
_ROS2 = """
import os, sys
import rclpy
from rcl_interfaces.srv import SetParameters
from rclpy.parameter import Parameter
owner, parameter, nonce = sys.argv[1:4]
rclpy.init(args=[])
node = rclpy.create_node("_rigel_delivery_%d" % os.getpid(), start_parameter_services=False,
                         enable_rosout=False)
client = node.create_client(SetParameters, owner + "/set_parameters")
if not client.wait_for_service(20):
    sys.exit("the node %s was not discovered within 20 s from inside its own pod" % owner)
wanted = Parameter(parameter, value=nonce).to_parameter_msg()
future = client.call_async(SetParameters.Request(parameters=[wanted]))
rclpy.spin_until_future_complete(node, future, timeout_sec=10)
if not future.done():
    sys.exit("the node %s did not answer within 10 s" % owner)
result = future.result().results[0]
sys.exit(0 if result.successful else "%s refused it: %s" % (owner, result.reason))
"""


@attrs.frozen(kw_only=True)
class DeliveryOptions:
    """Which messages must arrive where.

    Attributes:
        publisher: the node that publishes: its key in `nodes`, or its ROS name.
        subscriber: the node that logs each message that it receives.
        parameter: the ROS parameter whose value the publisher puts into its messages (ROS 2: of
            the publisher's own node).
        messages: how many messages with consecutive numbers must arrive.
        timeout: how long they may take.
        across_machines: both pods must run on different Kubernetes nodes.
        namespace: the application's namespace; unset: the context's.
        deployment_name: the release, as the job that deploys it names it.
    """

    publisher: str
    subscriber: str
    parameter: RosName = attrs.field(default=RosName("/nonce"))
    messages: Count = attrs.field(default=Count(10))
    timeout: Duration = attrs.field(default=Duration("60s"))
    across_machines: bool = True
    namespace: ObjectName | None = None
    deployment_name: ObjectName = attrs.field(default=ObjectName("rigel-k8s-application"))


@attrs.frozen
class RunningPod:
    """A pod as the check needs it, and the object that it was made of."""

    name: str
    machine: str
    ready: bool
    object: Mapping[str, Any] = attrs.field(repr=False)

    @classmethod
    def of(cls, pod: Mapping[str, Any]) -> RunningPod:
        """Return a pod object as the check needs it."""
        name, machine = pod["metadata"]["name"], pod["spec"].get("nodeName", "")
        return cls(name, machine, stays_ready(pod), pod)

    @property
    def container(self) -> str:
        """Its first container, or its node's."""
        return str(self.object["spec"]["containers"][0]["name"])

    def __str__(self) -> str:
        state = "" if self.ready else ", not ready"
        return f"pod {self.name} on {self.machine or 'no machine yet'}{state}"


class DeliveryJob:
    """Checks that new messages arrive, without a gap, and if requested from another machine."""

    options: ClassVar[type[DeliveryOptions]] = DeliveryOptions
    needs_cluster: ClassVar[bool] = True

    def check(self, options: DeliveryOptions, application: Application) -> Sequence[Problem]:
        """Return what cannot work: a node that receives its own messages proves nothing."""
        if options.publisher == options.subscriber:
            message = "publisher and subscriber are the same node: name two"
            return [Problem(("subscriber",), message, "same-node")]
        return []

    def run(self, options: DeliveryOptions, job: JobContext) -> None:
        """Find both pods, set the nonce, follow the subscriber's log.

        Raises:
            RigelK8sError: what did not arrive, and what did instead.
        """
        with connect(job.settings) as cluster:
            cluster.endure(job.report.line, job.cancel)
            namespace = job.settings.namespace or options.namespace or cluster.namespace
            over = _limit_time(job.cancel, options.timeout.seconds)
            _Check(cluster, str(namespace), options, job, over).run()


@attrs.frozen
class _Check:
    cluster: Cluster
    namespace: str
    options: DeliveryOptions
    job: JobContext
    over: threading.Event

    @property
    def _way(self) -> str:
        return f"{self.options.publisher} to {self.options.subscriber}"

    def run(self) -> None:
        publisher = self._pod(self.options.publisher)
        subscriber = self._pod(self.options.subscriber)
        if self.options.across_machines and publisher.machine == subscriber.machine:
            raise RigelK8sError(
                f"{self.options.publisher} and {self.options.subscriber} run on one machine, "
                f"{publisher.machine}: messages do not cross the network",
                hint="place them on different machines (`placement: {apart_from: [...]}`), "
                "or set across_machines: false",
            )
        nonce = f"n{secrets.token_hex(8)}"
        self._set(publisher, nonce)
        self._follow(publisher, subscriber, Arrivals(nonce))

    def _pod(self, key: str) -> RunningPod:
        """Return the newest ready pod of a node; wait while a pod is not ready yet."""
        while True:
            found = [RunningPod.of(pod) for pod in self._pods() if _is_of(pod, key)]
            ready = [pod for pod in found if pod.ready]
            if ready:
                return ready[-1]
            if not found or self.over.wait(LOOK):
                raise self._interruption(self._no_pod_error(key, found))
            self.job.report.progress(key, "waiting for a ready pod")

    def _pods(self) -> list[dict[str, Any]]:
        """Return the release's pods, the oldest first."""
        release = ReleaseId(self.namespace, str(self.options.deployment_name))
        pods = split_all(list_pods(self.cluster, release))
        return sorted(pods, key=lambda pod: str(pod["metadata"].get("creationTimestamp")))

    def _no_pod_error(self, key: str, found: Sequence[RunningPod]) -> RigelK8sError:
        where = f"release {self.options.deployment_name} in namespace {self.namespace}"
        if found:
            return RigelK8sError(
                f"{key} has no ready pod in {where}",
                details=[str(pod) for pod in found],
                hint="see `rigel status`",
            )
        known = sorted({_name_of(pod) for pod in self._pods()})
        return RigelK8sError(
            f"{key} has no pod in {where}",
            details=[f"it has pods of: {', '.join(known) or 'no node'}"],
            hint="name a node by its key, and the release by deployment_name and namespace",
        )

    def _set(self, publisher: RunningPod, nonce: str) -> None:
        """Set the parameter from inside the publisher's pod, as its own node would."""
        parameter = str(self.options.parameter)
        ros = ros_of(publisher.object, self.job.application.distro)
        for command in list_commands(publisher.object, ros, parameter, nonce):
            done = self.cluster.run(
                self.namespace, publisher.name, command, container=publisher.container
            )
            if done.code != NO_PYTHON:
                break
        if done.code:
            output = (done.stderr + done.stdout).decode("utf-8", "replace").splitlines()
            needs = "the ROS master must answer and the image needs Python"
            if ros == "2":
                needs = "the node must declare it, and the image needs python3 with rclpy"
            raise RigelK8sError(
                f"cannot set the ROS parameter {parameter} from {publisher}",
                details=output[-5:],
                hint=f"{needs}; see `rigel status`",
            )

    def _follow(self, publisher: RunningPod, subscriber: RunningPod, arrivals: Arrivals) -> None:
        wanted = int(self.options.messages)
        lines = self.cluster.logs(
            self.namespace,
            subscriber.name,
            subscriber.container,
            follow=True,
            since_seconds=10,
            cancel=self.over,
        )
        for count in arrivals.count(lines):
            self.job.report.progress(self.options.subscriber, f"received {count} of {wanted}")
            if count >= wanted:
                break
        if arrivals.gap:
            lost = f"a message of {self._way} is missing: {arrivals.gap}"
            raise self._failure(lost, publisher, subscriber, arrivals)
        if len(arrivals.numbers) < wanted:
            received = f"{len(arrivals.numbers)} of {wanted} messages of {self._way} arrived"
            late = f"{received} within {self.options.timeout}"
            raise self._interruption(self._failure(late, publisher, subscriber, arrivals))
        self.job.report.line(
            f"{wanted} messages, {arrivals.numbers[0]} to {arrivals.numbers[-1]}, arrived from "
            f"{self.options.publisher} ({publisher.machine}) "
            f"at {self.options.subscriber} ({subscriber.machine})"
        )

    def _failure(
        self, message: str, publisher: RunningPod, subscriber: RunningPod, arrivals: Arrivals
    ) -> RigelK8sError:
        last = [f"  {line}" for line in arrivals.last] or ["  nothing"]
        return RigelK8sError(
            message,
            details=[
                f"{self.options.publisher}: {publisher}",
                f"{self.options.subscriber}: {subscriber}",
                f"the parameter {self.options.parameter} was set to {arrivals.nonce}",
                "the subscriber's last lines:",
                *last,
            ],
            hint=f"`rigel logs {self.options.publisher}`: does it log that value and a number? "
            "`rigel status`: are the two connected?",
        )

    def _interruption(self, error: RigelK8sError) -> RigelK8sError:
        """Return the error, or that the job was cancelled before its time was over."""
        return Interrupted("stopped before it was finished") if self.job.cancel.is_set() else error


class Arrivals:
    """The numbers of a nonce's messages in a log, each one more than the one before.

    Attributes:
        numbers: those that arrived.
        last: the last lines that were read.
        gap: which message is missing between two that arrived; counting ends there.
    """

    def __init__(self, nonce: str) -> None:
        self.nonce = nonce
        self.numbers: list[int] = []
        self.last: list[str] = []
        self.gap: str | None = None
        self._pattern = re.compile(rf"\b{re.escape(nonce)}\b\D*(\d+)")

    def count(self, lines: Iterable[str]) -> Iterator[int]:
        """Yield how many have arrived, each time it grows."""
        for line in lines:
            self.last = [*self.last, line][-5:]
            found = self._pattern.search(line)
            if found and self._add(int(found.group(1))):
                yield len(self.numbers)
            if self.gap:
                return

    def _add(self, number: int) -> bool:
        """Note a number; a repeated line of the log does not count again."""
        before = self.numbers[-1] if self.numbers else number - 1
        if number not in (before, before + 1):
            self.gap = f"after message {before} came {number}"
        if number != before + 1:
            return False
        self.numbers.append(number)
        return True


def _limit_time(cancel: threading.Event, seconds: float) -> threading.Event:
    """Return an event that is set when the time is over, or when the job is cancelled."""
    over = threading.Event()

    def watch() -> None:
        cancel.wait(seconds)
        over.set()

    threading.Thread(target=watch, daemon=True).start()
    return over


def _name_of(pod: Mapping[str, Any]) -> str:
    return str(pod["metadata"].get("labels", {}).get(NAME_LABEL, pod["metadata"]["name"]))


def _is_of(pod: Mapping[str, Any], key: str) -> bool:
    """Return whether a pod is that of a node's key, its ROS name, or its Deployment's name."""
    ros_name = pod["metadata"].get("annotations", {}).get(ROS_NAME_ANNOTATION, "")
    return _name_of(pod) in (key, object_name(key)) or ros_name.lstrip("/") == key.lstrip("/")


def ros_of(pod: Mapping[str, Any], distro: str) -> str:
    """Return the ROS of a pod, "1" or "2": from its annotation, else that of `distro`."""
    note = pod["metadata"].get("annotations", {}).get(NETWORK_ANNOTATION)
    noted = json.loads(note).get("ros") if note else None
    return generation_of(distro, noted).name


def list_commands(
    pod: Mapping[str, Any], ros: str, parameter: str, nonce: str
) -> Sequence[Sequence[str]]:
    """Return the commands that set the parameter, to be tried while one ends with NO_PYTHON."""
    start = ["/bin/sh", f"{MOUNT_PATH}/exec.sh"]
    if ros == "1":
        return [[*start, p, "-c", _ROS1, parameter, nonce] for p in ("python3", "python")]
    owner = str(pod["metadata"].get("annotations", {}).get(ROS_NAME_ANNOTATION, ""))
    return [[*start, "python3", "-c", _ROS2, owner, parameter.lstrip("/"), nonce]]
