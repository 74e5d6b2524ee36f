"""What a job deploys, as it should be on the cluster: options in, Desired out; pure."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import attrs

from rigel_k8s.app.application import flat
from rigel_k8s.app.generation import Generation, Texts, generation_of
from rigel_k8s.app.options import OrchestrationOptions
from rigel_k8s.app.security import restrict
from rigel_k8s.app.workloads import Workloads
from rigel_k8s.objects.images import add_pull_secrets, images_of, pin_images
from rigel_k8s.objects.pods import Object
from rigel_k8s.objects.refs import Manifest, ref_of
from rigel_k8s.objects.steady import steady
from rigel_k8s.objects.workloads import ReleaseContext
from rigel_k8s.observability.names import EXPORTER
from rigel_k8s.problems import Path, Problem
from rigel_k8s.release.types import Desired, ReleaseId
from rigel_k8s.settings import Application

#: What to do if a right is missing, by the kind of object; if the cluster refuses pods, by the
#: reason of the refusal.
REMEDIES = {
    "PersistentVolume": "`host_path` in `persistent_storage` makes a PersistentVolume, which no"
    " Role in a namespace covers: ask an administrator for a ClusterRole, or set `host_path` in the"
    " node's own `volumes` instead, which needs no right",
    "pod-security": "set `security: restricted` for pods that every namespace accepts; see their"
    " requests with `rigel render`",
    "quota": "request less (`resources`, `replicas`), or let an administrator raise the quota",
    "no-resources": "set `resources` of each node: the quota needs them",
    "limit-range": "set `resources` within the limits of the namespace: `kubectl describe limits`",
    "architecture": "build it for them too (`platforms` of a build job), or choose other machines"
    " with `placement`",
    "policy": "change what the policy names, or ask its author",
    "no-machine": "or change its `placement`",
    "taint": "or set `tolerations` of the node",
    "no-room": "request less (`resources`), or let it run elsewhere (`placement`)",
    "missing-object": "create it first, or correct its name",
    "no-image": "push it, or correct its name",
}
#: The options that such a reason is about: a pattern of one of their keys.
ABOUT = {
    **dict.fromkeys(("no-image", "architecture"), "image"),
    **dict.fromkeys(("no-machine", "taint"), "placement"),
    "no-room": "resources",
    "missing-object": "(?i).*(config_?map|secret|storage_?class|claim).*",
}
#: What outlives `down`.
PROTECTED = ("PersistentVolumeClaim", "PersistentVolume")


def draft(
    options: OrchestrationOptions,
    release: ReleaseId,
    application: Application,
    texts: Texts,
    *,
    previous: Sequence[Manifest] = (),
) -> Draft:
    """Return the release that the options describe.

    Args:
        previous: the objects of the last revision, which have the addresses in use.
    """
    ros = generation_of(application.distro, options.ros)
    context = ReleaseContext(
        namespace=release.namespace,
        release=release.name,
        distro=application.distro,
        ros=ros,
        pull_secrets=tuple(map(str, options.image_pull_secrets)),
        layer=bool(texts.libraries),
    )
    workloads = Workloads(options, ros.in_context(context, options), texts)
    traced = []
    for path, item in workloads.objects(workloads.plan(previous)):
        # The exporter's pods are restricted already.
        if options.security is not None and item["metadata"]["name"] != EXPORTER:
            item = restrict(item, options.security, ros)
        traced.append((path, steady(item)))
    return Draft(release, ros, traced)


@attrs.frozen
class Draft:
    """A release before the digests of its images and its pull secrets are known.

    Attributes:
        traced: its objects, each with the path of the options that it comes from.
    """

    release: ReleaseId
    ros: Generation
    traced: Sequence[tuple[Path, Object]]

    @property
    def objects(self) -> tuple[Object, ...]:
        return tuple(item for _, item in self.traced)

    @property
    def images(self) -> tuple[str, ...]:
        """The images of all its workloads, each once."""
        return images_of(self.objects)

    def finish(
        self,
        *,
        raw: Mapping[str, Any] | None = None,
        digests: Mapping[str, str] | None = None,
        pull_secrets: Sequence[str] = (),
        create_namespace: bool = False,
    ) -> Desired:
        """Return the release as it should be on the cluster.

        Args:
            raw: the options as plain data, kept in the revision.
            digests: image reference to the same with its digest, for those that are known.
            pull_secrets: further Secrets with registry credentials.
        """
        final = [
            add_pull_secrets(pin_images(item, digests or {}), pull_secrets) for item in self.objects
        ]
        return Desired(
            release=self.release,
            objects=tuple(self.ros.bind(final)),
            origins={ref_of(item): path for path, item in self.traced},
            options=options_to_keep(raw or {}),
            create_namespace=create_namespace,
            protected=frozenset(map(ref_of, (m for m in self.objects if m["kind"] in PROTECTED))),
            remedies={**REMEDIES, **self.ros.remedies(self.objects)},
        )


def options_to_keep(raw: Mapping[str, Any]) -> dict[str, Any]:
    """Return the options that a revision keeps: all but a password."""
    result = flat(raw)
    grafana = (result.get("observability") or {}).get("grafana") or {}
    grafana.pop("admin_password", None)
    return result


def point_out(problem: Problem, raw: Mapping[str, Any]) -> Problem:
    """Return a problem at the option of `raw` that it is about: its message names the value."""
    about, path = re.compile(ABOUT.get(problem.kind, "")), problem.path
    options = list(list_options(flat(raw)))
    own = [one for one in options if one[0][: len(path)] == path]
    named = [
        place
        for place, value in (*own, *options)
        if any(about.fullmatch(str(key)) for key in place) and is_named(value, problem.message)
    ]
    whole = [place for place, _ in own if about.fullmatch(str(place[-1]))]
    return attrs.evolve(problem, path=[*named, *whole, path][0])


def list_options(value: Any, path: Path = ()) -> Iterator[tuple[Path, Any]]:
    """Yield the paths of all values in options, with the values: the outer ones first."""
    items = enumerate(value) if isinstance(value, list) else ()
    for key, inner in value.items() if isinstance(value, Mapping) else items:
        yield (*path, key), inner
        yield from list_options(inner, (*path, key))


def is_named(value: Any, message: str) -> bool:
    """Whether a message has an option's value as a word; of an image, without its digest."""
    word = rf"(?<![\w/.:-]){re.escape(str(value).partition('@')[0])}(?![\w/.:@-])"
    return not isinstance(value, Mapping | list) and bool(re.search(word, message))
