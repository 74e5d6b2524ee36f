"""What a container requests, and its limits, as every job type writes it."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from decimal import Decimal
from typing import ClassVar

import attrs

from rigel_k8s.objects.fields import option
from rigel_k8s.objects.scalars import LabelKey, Quantity
from rigel_k8s.option_text import has_template
from rigel_k8s.problems import Problem


@attrs.frozen(kw_only=True)
class Resources:
    """What a container requests, and its limits."""

    foreign: ClassVar[Mapping[str, str]] = dict.fromkeys(
        ("cpu", "memory"), "write it below `limits`"
    )

    requests: Mapping[LabelKey, Quantity] = option(
        "by resource: cpu, memory, nvidia.com/gpu ...", {}
    )
    limits: Mapping[LabelKey, Quantity] = option("by resource", {})


def check_resources(resources: Resources) -> Iterator[Problem]:
    """Yield memory without its unit, and requests that do not fit their limits."""
    requests, limits = resources.requests, resources.limits
    wrong = set()
    for name in map(LabelKey, ("memory", "ephemeral-storage")):
        for place, chosen in (("requests", requests), ("limits", limits)):
            if problem := explain_few_bytes(chosen.get(name)):
                yield Problem(("resources", place, str(name)), problem, "bad-quantity")
                wrong.add(name)
    for name in dict.fromkeys((*limits, *requests)):
        limit = limits.get(name)
        asked = requests.get(name, limit or Quantity())
        if name in wrong or has_template(f"{asked}{limit}"):
            continue
        most = None if limit is None else parse_quantity(limit)
        path = ("resources", "requests", str(name))
        if ("/" in name or name.startswith("hugepages-")) and parse_quantity(asked) != most:
            message = f"{name} needs a limit, and requests the same: write it below `limits` only"
            yield Problem(path, message, "conflict", at_key=True)
        elif "/" in name and most and most % 1:
            message = f"{limit} of {name} is not a whole number: nothing has a part of one"
            yield Problem(("resources", "limits", str(name)), message, "bad-quantity")
        elif most is not None and parse_quantity(asked) > most:
            message = (
                f"{asked} is more than the limit, {limit}: request less, or raise limits.{name}"
            )
            yield Problem(path, message, "conflict")


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
