"""The option `security`; independent of Kubernetes objects."""

# ruff: noqa: RUF009 - option() returns an attrs field, a new one for each use
from __future__ import annotations

from typing import Literal

import attrs

from rigel_k8s.objects.fields import option
from rigel_k8s.objects.scalars import Number

#: The level's name in a Rigelfile, as in Kubernetes.
Level = Literal["restricted"]


class UserId(Number):
    """A numeric user that is not root."""

    kind = "bad-user"
    expects = "a numeric user ID, 1 or more (0 is root)"
    least = 1


@attrs.frozen(kw_only=True)
class Security:
    """What the application's containers may do."""

    level: Level = option(
        "restricted: pods pass Kubernetes' Pod Security level of that name: no root, no privileges,"
        " a read-only image, HOME and /tmp as volumes of the pod",
        "restricted",
    )
    user: UserId = option(
        "the numeric user and group of the containers; the image does not need an entry for it",
        UserId(1000),
    )
    read_only: bool = option("mount the images read-only; HOME and /tmp are writable", default=True)


def security_of(value: Security | Level | None) -> Security | None:
    """Return the security; a word is short for its `level`."""
    return Security(level=value) if isinstance(value, str) else value
