"""The option `muto` of a job that deploys."""

# ruff: noqa: RUF009 - option() returns an attrs field, a new one for each use
from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import attrs

from rigel_k8s.objects.fields import option, required_field
from rigel_k8s.objects.scalars import EnvName
from rigel_k8s.option_text import Scalar
from rigel_muto.ditto import Access
from rigel_muto.opening import SCHEMES, check_url


@attrs.frozen(kw_only=True)
class Muto:
    """A stack of Eclipse Muto."""

    stack: str | Mapping[str, Any] = required_field(
        "a file with a stack, from the application's directory; the id (stackId, thingId) of a"
        " stack in one of the files there, or at twin_url; or the stack itself, as a mapping"
    )
    args: Mapping[str, Scalar] = option("values of the stack's arguments, `$(arg NAME)`", {})
    references: Mapping[str, str] = option(
        "the files of stacks whose ids several files have, by id", {}
    )
    strict: bool = option("refuse a stack of which something is not carried over", default=False)
    twin_url: str | None = option(
        "a Ditto whose things are stacks, asked for what no file has: what stands before"
        " /api/2/things"
    )
    token: EnvName | None = option("the environment variable with a bearer token for it")
    user: str | None = option("a user of it")
    password: EnvName | None = option("the environment variable with the user's password")

    def __attrs_post_init__(self) -> None:
        """Refuse options that contradict each other."""
        name = self.stack if isinstance(self.stack, str) else ""
        if name.startswith("data:"):
            raise ValueError("a stack cannot be a data URL: write the stack itself, as a mapping")
        if name.startswith(SCHEMES):
            raise ValueError(
                "a stack cannot be a URL: write its id, and what stands before /api/2/things as"
                " `twin_url`"
            )
        if self.twin_url:
            check_url(self.twin_url)
        if (self.user is None) != (self.password is None):
            raise ValueError("user and password belong together")
        if self.token and self.user:
            raise ValueError("a token, or a user and a password: leave one out")
        if (self.token or self.user) and not self.twin_url:
            raise ValueError("token, user and password need twin_url")

    @property
    def access(self) -> Access:
        return Access(self.token, self.user, self.password)
