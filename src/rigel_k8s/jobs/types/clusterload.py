"""Loads image archives onto the nodes of a local cluster, identified by its context's name."""

from __future__ import annotations

import os
import shutil
import threading
from collections.abc import Callable
from pathlib import Path

from rigel_k8s import lab
from rigel_k8s.errors import RigelK8sError, UserError
from rigel_k8s.images.process import stream
from rigel_k8s.settings import Settings


def load_archive(
    archive: Path, context: str, report: Callable[[str], None], cancel: threading.Event
) -> None:
    """Import an image archive on every node of a context's cluster.

    Raises:
        UserError: the context's name is not that of a cluster on this machine.
        RigelK8sError: the program that loads is missing or failed.
    """
    own = context.removeprefix("rigel-")
    if context.startswith("rigel-") and own in lab.cluster.names():
        lab.cluster.load([str(archive)], own, report=report)
        return
    words = _command(archive, context)
    if shutil.which(words[0]) is None:
        raise RigelK8sError(
            f"context {context}: {words[0]} is not installed, which loads images",
            hint="install it, or push to a registry that the cluster pulls from",
        )
    stream(words, what=f"{words[0]} loading into {context}", env=os.environ, cancel=cancel)


def _command(archive: Path, context: str) -> list[str]:
    kind, _, name = context.partition("-")
    if kind == "kind" and name:
        return ["kind", "load", "image-archive", str(archive), "--name", name]
    if kind == "k3d" and name:
        return ["k3d", "image", "import", str(archive), "--cluster", name]
    if kind == "minikube":
        return ["minikube", "--profile", context, "image", "load", str(archive)]
    raise UserError(
        f"cluster_load: context {context} is not a cluster of rigel, kind, k3d or minikube",
        hint="push to a registry that the cluster pulls from instead (`push: true`)",
    )


def current_context(settings: Settings) -> str:
    """Return the context that the command line or the kubeconfig names."""
    if settings.context:
        return settings.context
    from rigel_k8s.kube.kubeconfig import candidates, merge_files

    files = candidates(settings.kubeconfig, os.environ)
    current = merge_files([file for file in files if file.exists()])["current-context"]
    if current:
        return str(current)
    raise UserError(
        "cluster_load: there is no current Kubernetes context",
        hint="choose one with --context, or create a cluster with `rigel cluster up`",
    )
