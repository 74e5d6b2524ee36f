"""One release's life under faults: commands drawn from a seed, each followed by checks.

After a command with faults, its exit code and output must match the objects in the API server. Then
the same command without faults must complete it.
"""

from __future__ import annotations

import json
import re
from collections.abc import Iterator, Sequence
from pathlib import Path
from random import Random
from typing import Any

import attrs

from bench.chaos.calling import HUNG, Caller
from bench.chaos.control_plane import kubeconfig
from bench.chaos.faults import draw_weather
from bench.chaos.kubelet import BAD
from bench.chaos.proxy import FaultProxy
from rigel_k8s.kube.cluster import Cluster
from rigel_k8s.objects.marks import RELEASE_LABEL
from rigel_k8s.objects.refs import ObjectRef
from rigel_k8s.release.revisions import NUMBER, OF, STATUS

RELEASE = "rigel-k8s-application"
HANG = 120.0  # seconds after which a command counts as hanging, even on a busy machine
ROLL_OUT, HOPELESS = "20s", "3s"
UNHURRIED = "100s"  # time-out of commands without faults, enough for a busy machine
KINDS = (("apps/v1", "Deployment"), ("v1", "ConfigMap"), ("v1", "Service"))


@attrs.frozen
class Content:
    """What to deploy: a number in each node's command, and the nodes."""

    number: int
    nodes: tuple[str, ...]
    image: str

    @property
    def works(self) -> bool:
        """Whether its pods become ready."""
        return BAD not in self.image


@attrs.frozen
class Outcome:
    """The result of one command.

    Attributes:
        wrong: what is wrong, "" for nothing.
    """

    seed: int
    step: int
    command: str
    code: int
    wrong: str
    output: str = ""


@attrs.define
class Story:
    """A release in a namespace of its own.

    Attributes:
        content: what the release contains, None without a release.
        good: the contents of the revisions that became good, by their number.
    """

    seed: int
    proxy: FaultProxy
    caller: Caller
    cluster: Cluster
    token: str
    directory: Path
    content: Content | None = None
    good: dict[int, Content] = attrs.field(factory=dict)

    @property
    def namespace(self) -> str:
        """The story's namespace."""
        return f"chaos-{self.seed}"

    def play(self) -> Iterator[Outcome]:
        """Play all commands; ends with the first that goes wrong."""
        dice = Random(f"story {self.seed}")
        self.configure()
        try:
            for step in range(5):
                for outcome in self.play_step(step, dice):
                    yield outcome
                    if outcome.wrong:
                        return
        finally:
            self.proxy.begin(None)
            self.cluster.delete(ObjectRef("v1", "Namespace", "", self.namespace))

    def configure(self) -> None:
        """Write the kubeconfig of the proxy."""
        self.write("config", kubeconfig(self.proxy.url, self.token))

    def play_step(self, step: int, dice: Random) -> Iterator[Outcome]:
        """Play one command with faults and again without."""
        name = dice.choices(("deploy", "rollback", "down"), (6, 2, 1))[0]
        numbers = sorted(self.good)
        if self.content is None or (name == "rollback" and not numbers):
            name = "deploy"
        if name == "deploy":
            wanted = draw_content(dice, step, self.content)
            self.write("Rigelfile", rigelfile(self.namespace, wanted))
            content: Content | None = wanted
            patience = ROLL_OUT if wanted.works else HOPELESS
            words = ["run", "job", "deploy", "--timeout", patience]
        elif name == "rollback":
            number = dice.choice(numbers)
            content, words = self.good[number], ["rollback", str(number), "--timeout", ROLL_OUT]
        else:
            content, words = None, ["down", "-y"]
        for faults in (True, False):
            if not faults:
                words = [UNHURRIED if word == ROLL_OUT else word for word in words]
            weather = draw_weather(f"{self.seed} {step}") if faults else None
            self.proxy.begin(weather)
            code, output = self.call(words, faults=faults)
            self.proxy.begin(None)
            wrong = self.find_wrong(content, code, output, faults=faults)
            command = f"{' '.join(words)}{' with faults' if faults else ''}"
            yield Outcome(self.seed, step, command, code, wrong, output if wrong else "")
            if wrong:
                return
        self.note(content)

    def call(self, words: Sequence[str], *, faults: bool, hang: float = HANG) -> tuple[int, str]:
        """Run a command and return its exit code and output."""
        output = self.directory / "output"
        config, file = (str(self.directory / name) for name in ("config", "Rigelfile"))
        head = ["--kubeconfig", config, "-f", file]
        code = self.caller.call([*head, *words], output, hang, impatient=faults)
        return code, output.read_text(errors="replace")

    def find_wrong(self, content: Content | None, code: int, text: str, *, faults: bool) -> str:
        """Return what is wrong after a command, "" for nothing."""
        if code == HUNG:
            return f"it did not end within {HANG:g} s"
        if "Traceback" in text or "This is a bug" in text or "Exception ignored" in text:
            return "a traceback"
        if code == 0:
            return self.find_difference(content)
        if code == 2 and content is None and "there is no release" in text:
            return self.find_difference(None)
        errors = len(re.findall(r"^error: ", text, re.MULTILINE))
        if code != 1 or errors != 1:
            return f"exit code {code} with {errors} errors"
        if not faults and (content is None or content.works):
            return "it failed without a fault"
        return ""

    def find_difference(self, content: Content | None) -> str:
        """Return how the objects in the API server differ from a success."""
        if content is not None and not content.works:
            return "it reports as ready what cannot be"
        found = {kind: self.list(version, kind) for version, kind in KINDS}
        records = self.list("v1", "Secret", OF)
        if content is None:
            left = [live["metadata"]["name"] for kind in found.values() for live in kind]
            left += [record["metadata"]["name"] for record in records]
            return f"left after down: {', '.join(left)}" if left else ""
        names = {live["metadata"]["name"] for live in found["Deployment"]}
        if names != set(content.nodes):
            return f"Deployments {sorted(names)}, not {sorted(content.nodes)}"
        for live in found["Deployment"]:
            if not is_complete(live, content):
                return f"Deployment {live['metadata']['name']} is not ready: {live['status']}"
        newest = max(records, key=number_of, default=None)
        if newest is None or status_of(newest) != "good":
            return "the newest revision is not good"
        return ""

    def list(self, version: str, kind: str, label: str = RELEASE_LABEL) -> list[dict[str, Any]]:
        """Return the release's objects of a kind that are not being deleted."""
        found = self.cluster.list(version, kind, self.namespace, labels={label: RELEASE})
        return [live for live in found if not live["metadata"].get("deletionTimestamp")]

    def note(self, content: Content | None) -> None:
        """Record the release's content, and the revisions for a rollback."""
        self.content = content
        records = self.list("v1", "Secret", OF)
        good = {number_of(one) for one in records if status_of(one) == "good"}
        self.good = {number: one for number, one in self.good.items() if number in good}
        if content and content.works and records:
            self.good[max(good)] = content

    def write(self, name: str, value: object) -> None:
        """Write a file of the story."""
        (self.directory / name).write_text(json.dumps(value))


def draw_content(dice: Random, step: int, before: Content | None) -> Content:
    """Return the next content: the same, another command, other nodes, a bad image."""
    nodes = tuple(dice.sample(("camera", "driver", "talker"), dice.randint(1, 2)))
    kind = dice.choices(("same", "changed", "renamed", "bad"), (2, 4, 3, 1))[0]
    image = f"reg.invalid/{BAD if kind == 'bad' else 'ros'}@sha256:{'a' * 64}"
    if before is None or kind == "renamed":
        return Content(step, nodes, image)
    if kind == "same":
        return before
    return Content(step, before.nodes, image)


def rigelfile(namespace: str, content: Content) -> dict[str, Any]:
    """Return the Rigelfile of a content."""
    node = {"image": content.image, "command": ["/node", f"number={content.number}"]}
    options = {
        "namespace": namespace,
        "deploy_ros_master": False,
        "ros_master_uri": "http://robot:11311",
        "nodes": {name: {**node, "parameters": {"of": name}} for name in content.nodes},
    }
    job = {"plugin": "rigel_k8s.OrchestrationPlugin", "with": options}
    return {"application": {"distro": "noetic"}, "jobs": {"deploy": job}}


def is_complete(live: dict[str, Any], content: Content) -> bool:
    """Whether a Deployment has rolled out a content, as Kubernetes defines it."""
    status, wanted = live.get("status") or {}, live["spec"]["replicas"]
    text = json.dumps(live["spec"]["template"])
    return (
        f"number={content.number}" in text
        and content.image in text
        and status.get("observedGeneration", 0) >= live["metadata"]["generation"]
        and all(
            status.get(key, 0) == wanted
            for key in ("replicas", "updatedReplicas", "availableReplicas")
        )
    )


def number_of(record: dict[str, Any]) -> int:
    """Return a revision's number."""
    return int(record["metadata"]["labels"][NUMBER])


def status_of(record: dict[str, Any]) -> str:
    """Return a revision's status."""
    return str(record["metadata"]["labels"][STATUS])


def play(
    seed: int, proxy: FaultProxy, caller: Caller, cluster: Cluster, token: str, directory: Path
) -> Iterator[Outcome]:
    """Play the story of a seed."""
    place = directory / str(seed)
    place.mkdir(exist_ok=True)
    yield from Story(seed, proxy, caller, cluster, token, place).play()
