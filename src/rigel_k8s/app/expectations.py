"""The option `expect`: what is expected of topics."""

# ruff: noqa: RUF009 - option() returns an attrs field, a new one for each use
from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, ClassVar, Literal

import attrs

from rigel_k8s.objects.fields import option
from rigel_k8s.objects.naming import ros_name
from rigel_k8s.objects.scalars import Duration, Range, RosName

if TYPE_CHECKING:
    from rigel_exporter.expecting import Expected


@attrs.frozen(kw_only=True)
class Expectation:
    """What is expected of a topic."""

    example: ClassVar[str] = "{rate: 8..12}"

    type: str | None = option("its type, such as sensor_msgs/msg/LaserScan")
    rate: Range | None = option(
        "messages per second: 8..12, 8.. (or more), ..12 (or fewer); 10 is short for 8..12, a fifth"
        " less or more"
    )
    gap: Duration | None = option(
        "ROS 2: the longest time between two messages of a publisher, as in 500ms"
    )
    age: Duration | None = option(
        "ROS 2: how old a message may be when a subscriber takes it, as in 200ms"
    )
    publishers: Range | None = option("how many nodes publish it: 1, 1.., 2..3")
    subscribers: Range | None = option("how many nodes subscribe to it")
    otherwise: Literal["report", "rollback"] = attrs.field(
        default="report",
        metadata={
            "key": "else",
            "doc": "what to do about an update that breaks it: report it, or roll the update back",
        },
    )

    def describe(self) -> Expected:
        """Return it as it is judged; an application that expects nothing does not import that."""
        from rigel_exporter.expecting import Expected

        return Expected(
            type=self.type,
            rate=self.rate.around if self.rate else None,
            gap=self.gap.seconds if self.gap else None,
            age=self.age.seconds if self.age else None,
            publishers=self.publishers.limits if self.publishers else None,
            subscribers=self.subscribers.limits if self.subscribers else None,
            strict=self.otherwise == "rollback",
        )


def describe_all(expectations: Mapping[RosName, Expectation]) -> dict[str, Expected]:
    """Return what is expected by topics' full names; a relative name begins at the root."""
    return {ros_name(name): one.describe() for name, one in expectations.items()}
