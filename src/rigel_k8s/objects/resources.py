"""What a container requests, and its limits, as every job type writes it."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from decimal import Decimal

import attrs

from rigel_k8s.objects.fields import option
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


#: The factor of each suffix; longer suffixes are tried first.
SUFFIXES = {
    **{f"{letter}i": Decimal(1024) ** power for power, letter in enumerate("KMGTPE", 1)},
    **{letter: Decimal(1000) ** power for power, letter in enumerate("kMGTPE", 1)},
    "n": Decimal("1e-9"),
    "u": Decimal("1e-6"),
    "m": Decimal("1e-3"),
}


def parse_quantity(text: object) -> Decimal:
    """Return a quantity's value; exact, so that 3 times 0.1 is 0.3."""
    written = str(text)
    for suffix, factor in SUFFIXES.items():
        if written.endswith(suffix):
            return Decimal(written[: -len(suffix)]) * factor
    return Decimal(written)


def format_quantity(value: Decimal) -> str:
    """Return a value as a person writes it: 1500Mi, 250m, 3."""
    if value == value.to_integral_value():
        whole = int(value)
        for suffix in ("Gi", "Mi", "Ki"):
            if whole >= SUFFIXES[suffix] and whole % int(SUFFIXES[suffix]) == 0:
                return f"{whole // int(SUFFIXES[suffix])}{suffix}"
        return str(whole)
    return f"{(value * 1000).normalize():f}m"
