"""deploy, rollback, undo and down as tests call them: with options and Run's fields as keywords."""

from __future__ import annotations

from typing import Any

import attrs

from rigel_k8s.release import deploy as deploys
from rigel_k8s.release import removal
from rigel_k8s.release import rollback as rollbacks
from rigel_k8s.release.run import Run
from rigel_k8s.release.types import DeployOptions, Desired, Plan, ReleaseId, Revision

OPTIONS = frozenset(field.name for field in attrs.fields(DeployOptions))


def take_options(words: dict[str, Any]) -> DeployOptions:
    """Return the options among some keywords, which are removed there; None is the default."""
    found = {name: words.pop(name) for name in OPTIONS & words.keys()}
    return DeployOptions(**{name: value for name, value in found.items() if value is not None})


def make_run(desired: Desired, cluster: Any, **words: Any) -> Run:
    options = take_options(words)
    return Run(desired=desired, cluster=cluster, options=options, **words)


def deploy(desired: Desired, cluster: Any, **words: Any) -> Revision:
    return deploys.deploy_release(make_run(desired, cluster, **words))


def diff(desired: Desired, cluster: Any, *, adopt: bool = False) -> Plan:
    return deploys.look(cluster, desired, adopt=adopt).plan


def rollback(cluster: Any, release: ReleaseId, number: int | None = None, **words: Any) -> Revision:
    options = take_options(words)
    return rollbacks.rollback(cluster, release, number, options, **words)


def undo(cluster: Any, release: ReleaseId, failure: Any, target: int | None, **words: Any) -> Any:
    options = take_options(words)
    return rollbacks.undo(cluster, release, failure, target, options, **words)


def down(cluster: Any, release: ReleaseId, **words: Any) -> Plan:
    options = take_options(words)
    return removal.down(cluster, release, options, **words)
