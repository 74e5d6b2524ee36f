"""What a container requests, and its limits, as every job type writes it."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping

import attrs

from rigel_k8s.objects.fields import option
from rigel_k8s.objects.quantities import SUFFIXES, parse_quantity
from rigel_k8s.objects.scalars import LabelKey, Quantity
from rigel_k8s.option_text import has_template
from rigel_k8s.problems import Problem


@attrs.frozen(kw_only=True)
class Resources:
    """What a container requests, and its limits."""

    requests: Mapping[LabelKey, Quantity] = option(
        "by resource: cpu, memory, nvidia.com/gpu ...", {}
    )
    limits: Mapping[LabelKey, Quantity] = option("by resource", {})


def check_resources(resources: Resources) -> Iterator[Problem]:
    """Yield memory that no container can start with, and requests above their limits."""
    requests, limits = resources.requests, resources.limits
    memory = LabelKey("memory")
    wrong = set()
    for place, chosen in (("requests", requests), ("limits", limits)):
        if problem := explain_few_bytes(chosen.get(memory)):
            yield Problem(("resources", place, memory), problem, "bad-quantity")
            wrong.add(memory)
    for name, limit in limits.items():
        asked = requests.get(name, limit)
        if name in wrong or has_template(asked + limit):
            continue
        if parse_quantity(asked) <= parse_quantity(limit):
            continue
        message = f"{asked} is more than the limit, {limit}: request less, or raise limits.{name}"
        yield Problem(("resources", "requests", str(name)), message, "conflict")


def explain_few_bytes(memory: Quantity | None) -> str | None:
    """Return why memory is too small for any program: its unit is missing, or wrong."""
    if memory is None or has_template(memory) or not 0 < parse_quantity(memory) < SUFFIXES["Mi"]:
        return None
    number = re.sub(r"[a-zA-Z].*|\+", "", memory)
    return f"{memory} is {parse_quantity(memory).normalize():f} bytes: did you mean {number}Mi?"
