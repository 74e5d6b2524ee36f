"""What a wait reports: states as they change, causes, and the error if the roll-out fails."""

from __future__ import annotations

import re
from collections.abc import Collection, Iterable, Iterator, Sequence
from contextlib import suppress

import attrs

from rigel_k8s.errors import ClusterError, RolloutFailed
from rigel_k8s.objects.marks import image_remedy_of, is_optional, remedy_of
from rigel_k8s.objects.overlay import containers_of, pod_of
from rigel_k8s.objects.refs import Manifest, ObjectRef
from rigel_k8s.objects.text import join_words
from rigel_k8s.release.part import Run
from rigel_k8s.release.rollout.causes import CAUSES, ERROR, Cause, probe_failure
from rigel_k8s.release.rollout.patience import Ledger, Seen
from rigel_k8s.release.rollout.readiness import UNSEEN
from rigel_k8s.release.rollout.standing import Standing

LOG_LINES = 12
NO_ROS = re.compile(r"No module named '(rclpy|rospy)'")
HELD = ("PersistentVolumeClaim", "PersistentVolume")
LOGGED = ("crash", "restarted", "failed")  # causes of which the container's log says more


@attrs.define
class Account:
    """What a run reports of its roll-out.

    Attributes:
        good: the revision before, which became ready; 0 for none.
        shown: the state of each workload as it was reported last.
    """

    run: Run
    standing: Standing
    good: int
    ledger: Ledger
    shown: dict[ObjectRef, tuple[str, bool]] = attrs.field(factory=dict)

    def show_states(self) -> None:
        """Report the states that have changed; a workload with a cause shows that.

        What has no pods, such as a test, is left out, unless they have just ended.
        """
        for ref, state in self.standing.states.items():
            idle = ref.kind in ("Deployment", "Job") and state.done and not state.wanted
            if idle and ref not in self.shown:
                continue
            if ref not in self.ledger.refs and state.message != UNSEEN:
                turn = self.standing.find_turn(ref)
                text = f"{state.message}; {turn}" if turn else state.message
                self.show(ref, text, done=self.standing.is_ready(ref))

    def show(self, ref: ObjectRef, text: str, *, done: bool, brief: str = "") -> None:
        """Report the present state of a workload, once; if it has a `brief`, that decides."""
        if self.shown.get(ref) != (brief or text, done):
            self.shown[ref] = (brief or text, done)
            self.run.report.progress(ref.name, text, done=done)

    def note_causes(self, now: float) -> None:
        """Show what is wrong when it is seen; report what has passed.

        Raises:
            RolloutFailed: something has lasted too long.
        """
        found = list(self.standing.find_causes())
        wrong = {ref for ref, _ in found}
        coming = [ref for ref in self.standing.list_waiting() if ref not in wrong]
        unsteady = self.standing.unsteady
        fresh, passed = self.ledger.note(now, found, coming=coming, unsteady=unsteady)
        for seen in fresh:
            seen.lines = [seen.cause.message, *self.read_log(seen)]
        self.warn(passed)
        first = dict(reversed(found))  # of each workload: two causes would be shown in turn
        for ref, cause in first.items():
            self.show(ref, cause.message, done=False, brief=cause.brief)
        hopeless = [
            seen
            for seen in self.ledger.find_hopeless(now)
            if not is_optional(self.standing.targets[seen.ref])
        ]
        if hopeless:
            raise self.failure(hopeless)

    def warn(self, causes: Iterable[Seen]) -> None:
        """Report causes that have not made the roll-out fail."""
        for seen in causes:
            if seen.lines:
                message, *log = seen.lines
                self.run.report.warn("\n".join([f"{seen.ref.name}: {message}", *log]))
                seen.lines = []

    def leave_behind(self) -> None:
        """Report the optional workloads that the release runs without."""
        for ref in self.standing.list_waiting():
            lines = [line for seen in self.ledger.of(ref) for line in seen.lines]
            why, *rest = lines or [self.standing.states[ref].message]
            text = f"{ref.name} is not ready: {why}; {self.run.release.name} runs without it"
            next_step = remedy_of(self.standing.targets[ref]) or "`rigel status` shows its state"
            self.run.report.warn("\n".join([f"{text}; {next_step}", *rest]))
            self.run.report.progress(ref.name, "", done=True)
            for seen in self.ledger.of(ref):
                seen.lines = []

    def failure(self, hopeless: Sequence[Seen]) -> RolloutFailed:
        """Return the error for causes that will not go away; nodes often share an image."""
        first, what = hopeless[0], hopeless[0].cause.message
        known = list(self.ledger.seen.values())
        others = [seen for seen in known if seen.cause.message != what]
        failed = list(dict.fromkeys(seen.ref for seen in (*hopeless, *known) if seen not in others))
        names = ", ".join(ref.name for ref in failed)
        log = self.read_log(first)
        once = all(ref.kind == "Job" for ref in failed)
        fate = "did not succeed" if once else "did not become ready"
        return RolloutFailed(
            f"{self.name_survivor(failed)}{names} {fate}: {what}",
            hint=self.choose_hint(first.ref, first.cause, log),
            details=[*log, *self.list_causes(others)],
        )

    def timeout_error(self) -> RolloutFailed:
        """Return the error for a roll-out that took too long."""
        standing, related = self.standing, self.standing.related
        lines, late = [], standing.list_late()
        for ref in late:
            live = standing.live.get(ref)
            pods = related.list_newest_pods(live) if live else []
            failures = [probe_failure(pod, related.list_events(pod)) for pod in pods]
            state = standing.states[ref].message if ref in standing.states else "not seen"
            lines.append("; ".join([f"{ref.kind} {ref.name}: {state}", *filter(None, failures)]))
        lines += self.list_causes(self.ledger.seen.values())
        names = ", ".join(ref.name for ref in late)
        limit = self.run.options.limit
        many = f"{len(late)} of {len(standing.targets)} not ready within {limit:g} s"
        return RolloutFailed(
            f"{self.name_survivor(late)}{many}: {names}",
            hint=self.choose_hint(late[0]) if late else None,
            details=lines,
        )

    def name_survivor(self, failed: Collection[ObjectRef]) -> str:
        """Return the beginning of a failure: that the version before still does the work."""
        number = f" (revision {self.good})" if self.good else ""
        states = self.standing.states
        if not all(ref in states and states[ref].old_runs for ref in failed):
            return ""
        new = sorted(ref.name for ref in self.standing.rolling.difference(failed))
        if not new:
            return f"the old version still runs{number}; "
        names = join_words([ref.name for ref in failed])
        others = join_words(new)
        return f"the old version of {names} still runs{number}, and the new one of {others}; "

    def list_causes(self, causes: Iterable[Seen]) -> Iterator[str]:
        """Yield causes as lines, each once with the names of all that have it."""
        alike: dict[str, list[Seen]] = {}
        for seen in causes:
            alike.setdefault(seen.cause.message, []).append(seen)
        for message, same in alike.items():
            yield f"{', '.join(seen.ref.name for seen in same)}: {message}"
            yield from self.read_log(same[0])

    def read_log(self, seen: Seen) -> list[str]:
        """Return a crashed container's last lines, none if they cannot be read."""
        cause = seen.cause
        if cause.kind not in LOGGED or not cause.pod:
            return []
        with suppress(ClusterError):
            lines = self.run.cluster.logs(
                seen.ref.namespace,
                cause.pod,
                cause.container or None,
                tail=LOG_LINES,
                previous=cause.previous,
            )
            return [f"    {line}" for line in lines]
        return []

    def choose_hint(
        self, ref: ObjectRef, cause: Cause | None = None, log: Sequence[str] = ()
    ) -> str:
        """Return what to do next: about a cause, if it is known."""
        kind, target = cause.kind if cause else "", self.standing.targets[ref]
        command = self.run.options.write_command(f"logs {ref.name}", self.run.release)
        logs = f"{command} shows its output"
        remedy = logs if kind in ("", *LOGGED) else CAUSES[kind].remedy
        if not cause and ref.kind == "Job":
            remedy = f"if it takes longer, set `timeout`; {logs}"
        image = image_remedy_of(target)
        if cause and lacks_ros(target, cause):
            remedy = "`command` replaces the image's ENTRYPOINT, which loads ROS: use `args`"
        elif cause and (
            folder := find_folder(target, self.run.desired.objects, [cause.message, *log])
        ):
            remedy = (
                f"the container's user may not be allowed to write to {folder} of its machine:"
                f" `chown UID {folder}` there; {logs}"
            )
        elif image and kind in (*LOGGED, "image", "image-name", "start"):
            remedy = f"{image}; {remedy}"
        return f"{remedy}; {self.run.choose_way_out(self.good)}"


def lacks_ros(workload: Manifest, cause: Cause) -> bool:
    """Whether a container has not found ROS and runs a command without its image's ENTRYPOINT."""
    own = (one for one in containers_of(workload) if one["name"] == cause.container)
    return bool(NO_ROS.search(cause.message)) and any(one.get("command") for one in own)


def find_folder(
    workload: Manifest, objects: Iterable[Manifest], lines: Sequence[str]
) -> str | None:
    """Return the directory of a machine that errors name by the path at which it is mounted."""
    errors = [line for line in lines if ERROR.match(line)]
    kept = {
        one["metadata"]["name"]: one.get("spec") or {} for one in objects if one["kind"] in HELD
    }
    for volume in pod_of(workload).get("volumes") or ():
        claim = kept.get((volume.get("persistentVolumeClaim") or {}).get("claimName"), {})
        source = {**kept.get(claim.get("volumeName"), {}), **volume}.get("hostPath") or {}
        for container in containers_of(workload):
            for mount in container.get("volumeMounts") or ():
                place = f"{mount['mountPath'].rstrip('/')}/"
                found = mount["name"] == volume["name"] and not mount.get("readOnly")
                if source and found and any(place in line for line in errors):
                    return str(source["path"])
    return None
