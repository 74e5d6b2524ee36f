"""logs: of some or all ROS nodes, followed through restarts and roll-outs.

Past lines (`since`, `level`) come in the order of time, from Loki if it is
installed (history.py); current lines come unchanged, from the API server only.
"""

from __future__ import annotations

import threading
from collections.abc import Iterator, Sequence
from typing import Any

import attrs

from rigel_k8s.commands.logs.follow import Follow
from rigel_k8s.commands.logs.history import history
from rigel_k8s.commands.logs.lines import LogLine, LogOptions
from rigel_k8s.commands.pods import Pod, choose_pods
from rigel_k8s.commands.targets import release
from rigel_k8s.errors import ClusterError
from rigel_k8s.kube import Cluster
from rigel_k8s.settings import Settings


def logs(
    settings: Settings, nodes: Sequence[str], options: LogOptions, job: str | None = None
) -> Iterator[LogLine]:
    """Yield log lines of the nodes (all, if none is named); `follow` ends when it is closed.

    Raises:
        UserError: the node is unknown, or there is no pod at all.
        ClusterError: the one requested pod has no log.
    """
    found = release(settings, job, nodes)
    with found.cluster as cluster:
        if options.of_the_past or options.parsed or options.level:
            yield from history(found, nodes, options)
            return
        chosen = choose_pods(found, nodes)
        if options.follow:

            def read(pod: Pod, *, old: bool, cancel: threading.Event) -> Iterator[LogLine]:
                # A pod that started after this command is new from its beginning.
                words = options if old else attrs.evolve(options, since=None, tail=None)
                return lines_of(cluster, pod, words, follow=True, cancel=cancel)

            yield from Follow(found, {pod.workload for pod in chosen}, chosen, read).lines()
            return
        for pod in chosen:
            try:
                yield from lines_of(cluster, pod, options)
            except ClusterError as error:
                if len(chosen) == 1:
                    raise
                yield LogLine(pod.workload, pod.name, error.message, note=True)


def lines_of(cluster: Cluster, pod: Pod, options: LogOptions, **more: Any) -> Iterator[LogLine]:
    """Yield one pod's log lines."""
    texts = cluster.logs(
        pod.namespace,
        pod.name,
        pod.container,
        since_seconds=options.since,
        tail=options.tail,
        previous=options.previous,
        timestamps=options.timestamps,
        **more,
    )
    return (LogLine(pod.workload, pod.name, text) for text in texts)
