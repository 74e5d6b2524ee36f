"""Runs a program in a pod that goes on, and yields what it prints: messages, counts, parameters.

Why not run_inside: that returns when a program has ended, and has its own Python; these use the
ROS of the image and of the node there, as `rigel exec` does, and end with this process.
"""

from __future__ import annotations

import json
import os
import threading
from collections import deque
from collections.abc import Iterator, Mapping, Sequence
from io import BytesIO
from typing import Any

import attrs

from rigel_graph.discovery.inside import Place
from rigel_inpod.sent import LOADER, pack, read_module
from rigel_k8s.errors import ClusterError, RigelK8sError
from rigel_k8s.kube.cluster import Cluster
from rigel_k8s.kube.failures import explain_exec
from rigel_k8s.objects.pods import SCRIPTS_PATH

MOST = 100  # messages that wait for a slow terminal
#: ROS 1 before noetic is on Python 2, and its image may have a Python 3 without it.
START = """
case "${ROS_VERSION:-2}${ROS_PYTHON_VERSION:-2}" in
  1[!3]*) pythons="python2 python python3" ;;
  *) pythons="python3 python" ;;
esac
for python in $pythons; do
  command -v "$python" >/dev/null 2>&1 && exec "$python" -u -B -c "$0" "$@"
done
echo '{"error": "no-library", "text": "Python"}'
"""


class CannotRun(ClusterError):
    """A program in a pod cannot do what is requested; `word` is the reason, `text` its object."""

    def __init__(self, pod: str, word: str, text: str) -> None:
        super().__init__(f"in the pod {pod}: {text}")
        self.word, self.text = word, text


class Inbox:
    """The newest lines of a program's output, from the thread that receives them.

    A terminal that is too slow loses the oldest messages, and never shows old ones.
    """

    def __init__(self, most: int | None) -> None:
        self.most = most
        self.dropped = 0
        self.failure: RigelK8sError | None = None
        self._lines: deque[bytes] = deque()
        self._rest = b""
        self._ended = False
        self._changed = threading.Condition()

    def write(self, data: bytes) -> None:
        """Take output."""
        *lines, self._rest = (self._rest + data).split(b"\n")
        with self._changed:
            self._lines.extend(lines)
            while self.most is not None and len(self._lines) > self.most:
                self._lines.popleft()
                self.dropped += 1
            self._changed.notify()

    def flush(self) -> None:
        """Do nothing: lines are taken at once."""

    def end(self, failure: RigelK8sError | None) -> None:
        """Note that nothing more comes."""
        with self._changed:
            self._ended, self.failure = True, failure
            self._changed.notify()

    def read(self, within: float | None = None) -> Iterator[bytes]:
        """Yield lines until the end; raise what ended it, or that none came within some seconds."""
        while True:
            with self._changed:
                if not self._changed.wait_for(lambda: self._lines or self._ended, within):
                    raise ClusterError(
                        f"no message came within {within:g} s",
                        hint="`rigel topic echo` waits without a limit",
                    )
                if not self._lines:
                    break
                line = self._lines.popleft()
            yield line
        if self.failure:
            raise self.failure


@attrs.frozen
class Tool:
    """A program of rigel_inpod.sent for one generation of ROS."""

    name: str
    library: str

    def run(
        self, cluster: Cluster, pod: Place, request: Mapping[str, Any]
    ) -> Iterator[Mapping[str, Any]]:
        """Yield the program's answers; it ends when the generator is closed, or this process ends.

        `dropped` of a message counts those that were dropped in the pod and here, in all.

        Raises:
            CannotRun: what the program reports.
            ClusterError: it cannot be started, or the connection has ended.
        """
        inbox = Inbox(None if request.get("count") else MOST)
        silent, held = os.pipe()
        words = ["/bin/sh", f"{SCRIPTS_PATH}/exec.sh", "/bin/sh", "-c", START, LOADER]
        command = [*words, json.dumps(request)]
        modules = [(name, read_module(f"rigel_inpod.sent.{name}")) for name in ("lines", self.name)]
        threading.Thread(
            target=receive, args=(cluster, pod, command, silent, inbox), daemon=True
        ).start()
        try:
            os.write(held, pack(modules))
            for line in inbox.read(request.get("within")):
                answer = parse(line)
                if "error" in answer:
                    raise CannotRun(pod.name, answer["error"], answer["text"])
                if "dropped" in answer:
                    answer["dropped"] += inbox.dropped
                if answer:
                    yield answer
        finally:
            os.close(held)


def parse(line: bytes) -> dict[str, Any]:
    """Return an answer; empty for a line that is not one, such as what a library prints."""
    try:
        answer = json.loads(line)
    except ValueError:
        return {}
    return answer if isinstance(answer, dict) else {}


def receive(
    cluster: Cluster, pod: Place, command: Sequence[str], silent: int, inbox: Inbox
) -> None:
    """Run a command whose input is a pipe, until it ends."""
    errors = BytesIO()
    failure: RigelK8sError | None = None
    try:
        with os.fdopen(silent, "rb") as stdin:
            code = cluster.exec(
                pod.namespace,
                pod.name,
                command,
                container=pod.container,
                stdin=stdin,
                stdout=inbox,  # type: ignore[arg-type]
                stderr=errors,
            )
        if code:
            lines = errors.getvalue().decode("utf-8", "replace").splitlines()
            failure = ClusterError(
                f"the program in the pod {pod.name} failed with exit code {code}", details=lines
            )
    except ClusterError as error:
        failure = ClusterError(explain_exec(error), hint=error.hint)
    inbox.end(failure)


ROS1 = Tool("ros1_tools", "rospy")
ROS2 = Tool("ros2_tools", "rclpy")
