"""The options of the job that deploys Muto's agent."""

# ruff: noqa: RUF009 - option() returns an attrs field, a new one for each use
from __future__ import annotations

from collections.abc import Iterator

import attrs

from rigel_k8s.errors import UserError
from rigel_k8s.objects.fields import option, required_field
from rigel_k8s.objects.resources import Resources, check_resources
from rigel_k8s.objects.scalars import DottedName, ImageRef, ObjectName
from rigel_k8s.option_text import has_template
from rigel_k8s.problems import Problem
from rigel_muto.agent.address import read_address
from rigel_muto.opening import check_url


@attrs.frozen(kw_only=True)
class MutoAgent:
    """An agent that carries out commands of Eclipse Muto for one device."""

    thing: str = required_field("the device's id, NAMESPACE:NAME")
    broker: str = required_field("the MQTT broker: mqtt://HOST:PORT, or mqtts://HOST:PORT for TLS")
    job: str = required_field(
        "the orchestration job of this Rigelfile that commands deploy: it sets images, network and"
        " placement, and a command names the stack"
    )
    namespace: ObjectName | None = option(
        "the Kubernetes namespace of the agent and of what it deploys"
    )
    deployment_name: ObjectName = option("the agent's own release", ObjectName("muto-agent"))
    image: ImageRef | None = option("the agent's image, as `rigel image muto-agent` builds it")
    broker_secret: DottedName | None = option(
        "a Secret with username, password, ca.crt, tls.crt and tls.key for the broker; each may be"
        " missing"
    )
    prefix: str = option(
        "the beginning of the topics of Muto's ROS 2 generation and Symphony", "muto"
    )
    target: str | None = option("the device's name in Symphony (default: the NAME of `thing`)")
    twin_url: str | None = option(
        "the Ditto that has stacks, and that the agent reports to: the part before /api/2/things"
    )
    twin_user: str | None = option("a user of it")
    twin_secret: DottedName | None = option(
        "a Secret with the user's `password`; without `twin_user`, with a `token`"
    )
    stacks: list[str] | None = option(
        "the ids of stacks that commands may name, `*` for any text (default: all)"
    )
    whole_stacks: bool = option("commands may contain a stack, as Symphony's do", default=False)
    images: list[str] | None = option(
        "the images that commands may deploy, `*` for any text (default: all of the job)"
    )
    resources: Resources = attrs.field(factory=Resources, metadata={"doc": "requests and limits"})


def check_options(options: MutoAgent) -> Iterator[Problem]:
    """Yield values that the agent would refuse, and options that miss another one."""
    for key, check in (("thing", check_thing), ("broker", read_address), ("twin_url", check_url)):
        value = getattr(options, key)
        if value and not has_template(value):
            try:
                check(value)
            except UserError as error:
                message = "; ".join(filter(None, (error.message, error.hint)))
                yield Problem((key,), message, "bad-agent")
            except ValueError as error:
                yield Problem((key,), str(error), "bad-agent")
    yield from check_resources(options.resources)
    if options.twin_user and not options.twin_secret:
        message = "twin_user needs twin_secret, which has the password"
        yield Problem(("twin_user",), message, "bad-agent", at_key=True)
    if options.twin_secret and not options.twin_url:
        yield Problem(("twin_secret",), "twin_secret needs twin_url", "bad-agent", at_key=True)


def check_thing(thing: str) -> None:
    """Raise ValueError if a text is not the id of a device in Ditto."""
    if thing.count(":") != 1 or not all(thing.split(":")):
        raise ValueError(f'"{thing}" is not NAMESPACE:NAME')
