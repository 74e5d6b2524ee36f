"""Rights in a cluster as plain data: rules as a Role has them, and whether they are enough.

Pure; the checks before a deploy and the Roles that `rigel rbac` prints use the same rules.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterable, Iterator, Mapping
from typing import Any

import attrs

ANY = "*"


@attrs.frozen(order=True)
class Right:
    """One verb on one kind of object.

    Attributes:
        resource: the plural, as in URLs, with its subresource: `pods`, `pods/log`.
        group: "" is the core group.
        namespace: "" is the whole cluster.
    """

    group: str
    resource: str
    verb: str
    namespace: str = ""

    def is_granted_by(self, rule: Mapping[str, Any]) -> bool:
        """Whether a rule grants it; a rule with resource names counts as granting it."""
        _, _, sub = self.resource.partition("/")
        names = {self.resource, ANY} if not sub else {self.resource, ANY, f"*/{sub}"}
        resources = set(rule.get("resources") or [])
        return bool(
            {self.verb, ANY} & set(rule.get("verbs") or [])
            and {self.group, ANY} & set(rule.get("apiGroups") or [])
            and names & resources
        )


def name_resource(right: Right) -> str:
    """Return a resource with its group, as kubectl takes it: `deployments.apps`."""
    main, slash, sub = right.resource.partition("/")
    return (f"{main}.{right.group}" if right.group else main) + slash + sub


def find_missing(needed: Iterable[Right], rules: Iterable[Mapping[str, Any]]) -> list[Right]:
    """Return the rights that no rule grants, sorted."""
    granted = list(rules)
    return sorted(r for r in set(needed) if not any(map(r.is_granted_by, granted)))


def describe(rights: Iterable[Right]) -> list[str]:
    """Return rights as lines, one for each resource: `deployments.apps: create, patch`."""
    verbs: dict[str, list[str]] = defaultdict(list)
    for right in sorted(set(rights)):
        where = "" if right.namespace else " (in the whole cluster)"
        verbs[name_resource(right) + where].append(right.verb)
    return [f"{resource}: {', '.join(found)}" for resource, found in verbs.items()]


def make_rules(rights: Iterable[Right]) -> list[dict[str, Any]]:
    """Return rights as the rules of a Role: resources with the same verbs share a rule."""
    verbs: dict[tuple[str, str], set[str]] = defaultdict(set)
    for right in rights:
        verbs[right.group, right.resource].add(right.verb)
    together: dict[tuple[str, tuple[str, ...]], list[str]] = defaultdict(list)
    for (group, resource), found in sorted(verbs.items()):
        together[group, tuple(sorted(found, key=order))].append(resource)
    return [
        {"apiGroups": [group], "resources": resources, "verbs": list(words)}
        for (group, words), resources in together.items()
    ]


def order(verb: str) -> tuple[int, str]:
    """Return a key that sorts verbs as Kubernetes' documentation lists them."""
    usual = ("get", "list", "watch", "create", "update", "patch", "delete")
    return (usual.index(verb) if verb in usual else len(usual)), verb


def grant(group: str, resources: str, verbs: str, namespace: str = "") -> Iterator[Right]:
    """Yield the rights for all verbs on all resources; both are words separated by spaces."""
    for resource in resources.split():
        for verb in verbs.split():
            yield Right(group, resource, verb, namespace)
