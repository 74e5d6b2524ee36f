"""The ROS distributions, the newest first, and the last day of their support; plain data."""

from __future__ import annotations

from collections.abc import Mapping
from datetime import date
from types import MappingProxyType

#: noetic is the last one.
ROS1: Mapping[str, date] = MappingProxyType(
    {
        "noetic": date(2025, 5, 31),
        "melodic": date(2023, 5, 30),
        "lunar": date(2019, 5, 31),
        "kinetic": date(2021, 4, 30),
        "jade": date(2017, 5, 31),
        "indigo": date(2019, 4, 30),
        "hydro": date(2015, 5, 31),
    }
)
#: rolling has no end.
ROS2: Mapping[str, date] = MappingProxyType(
    {
        "lyrical": date(2031, 5, 31),
        "kilted": date(2026, 12, 31),
        "jazzy": date(2029, 5, 31),
        "iron": date(2024, 12, 4),
        "humble": date(2027, 5, 31),
        "galactic": date(2022, 12, 9),
        "foxy": date(2023, 6, 20),
        "eloquent": date(2020, 11, 30),
        "dashing": date(2021, 5, 31),
        "crystal": date(2019, 12, 31),
        "bouncy": date(2019, 7, 31),
        "ardent": date(2018, 12, 31),
        "rolling": date.max,
    }
)
#: The present distribution with the longest support.
CURRENT = "lyrical"

#: By the generation that they are of.
DISTROS: Mapping[str, Mapping[str, date]] = {"1": ROS1, "2": ROS2}
