"""deploy, rollback, undo and down as tests call them: with options and Run's fields as keywords."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import attrs

from rigel_k8s import deploy as deploys
from rigel_k8s.release import rollback as rollbacks
from rigel_k8s.release.look import refuse_or_plan
from rigel_k8s.release.part import Hooks, Part, Run, WayBack
from rigel_k8s.release.types import DeployOptions, Desired, Plan, ReleaseId, Revision

OPTIONS = frozenset(field.name for field in attrs.fields(DeployOptions))


@attrs.define
class Called(Hooks):
    """Hooks that a test gives as functions, which may want to know less."""

    before: Callable[[Plan], None] = lambda plan: None
    applied: Callable[[], None] = lambda: None
    approve: Callable[[], None] = lambda: None

    def before_pods(self, run: Run, plan: Plan) -> None:
        self.before(plan)

    def stored(self) -> None:
        self.applied()

    def verify(self, run: Run) -> None:
        self.approve()


def take_options(words: dict[str, Any]) -> DeployOptions:
    """Return the options among some keywords, which are removed there; None is the default."""
    found = {name: words.pop(name) for name in OPTIONS & words.keys()}
    return DeployOptions(**{name: value for name, value in found.items() if value is not None})


def make_run(desired: Desired, cluster: Any, **words: Any) -> Run:
    """Return a run; `before`, `applied` and `verify` are called as its hooks."""
    options = take_options(words)
    names = {"before": "before", "applied": "applied", "verify": "approve"}
    hooks = Called(**{names[name]: words.pop(name) for name in names.keys() & words.keys()})
    part = Part(desired=desired, hooks=hooks)
    return Run(part=part, cluster=cluster, options=options, **words)


def deploy(desired: Desired, cluster: Any, **words: Any) -> Revision:
    return deploys.write_release(make_run(desired, cluster, **words))


def diff(desired: Desired, cluster: Any, *, adopt: bool = False) -> Plan:
    return refuse_or_plan(Part(desired=desired), cluster, adopt=adopt).plan


def rollback(cluster: Any, release: ReleaseId, number: int | None = None, **words: Any) -> Revision:
    return deploys.roll_back(cluster, release, number, take_options(words))


def undo(cluster: Any, release: ReleaseId, failure: Any, target: int | None, **words: Any) -> Any:
    hint = words.pop("hint", "")
    run = make_run(Desired(release, ()), cluster, **words)
    return rollbacks.undo(run, failure, WayBack(target, hint), deploys.roll_back)


def down(cluster: Any, release: ReleaseId, **words: Any) -> Plan:
    volumes = words.pop("volumes")
    return deploys.down(cluster, release, take_options(words), volumes=volumes)
