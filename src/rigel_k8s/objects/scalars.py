"""Checks for values that Kubernetes or ROS would refuse; the error names what is valid.

Each class has `parse(raw)`, which raises ValueError with a message for the user, `kind`, the slug
of the problem, and `expects`, its text in a schema; one of keys may have `nested`, a hint for a
mapping as a key's value. The structurer uses nothing else.
"""

from __future__ import annotations

import re
from typing import ClassVar, TypeVar

from rigel_k8s.image_reference import is_reference

T = TypeVar("T", bound="Text")
N = TypeVar("N", bound="Number")
R = TypeVar("R", bound="RosName")


class Text(str):
    """A text of a certain form."""

    kind: ClassVar[str] = "bad-text"
    expects: ClassVar[str] = "text"
    pattern: ClassVar[re.Pattern[str]] = re.compile(r".+", re.S)
    longest: ClassVar[int] = 4096

    @classmethod
    def parse(cls: type[T], raw: str) -> T:
        """Return the value, or raise ValueError with what is expected."""
        if not cls.pattern.fullmatch(raw):
            raise ValueError(f'"{raw}" is not {cls.expects}')
        if len(raw) > cls.longest:
            raise ValueError(f'"{raw}" is too long: at most {cls.longest} characters')
        return cls(raw)


class Number(int):
    """A whole number within bounds."""

    kind: ClassVar[str] = "bad-number"
    expects: ClassVar[str] = "a whole number"
    least: ClassVar[int] = 0
    most: ClassVar[int] = 2**31 - 1

    @classmethod
    def parse(cls: type[N], raw: str) -> N:
        """Return the value, or raise ValueError with what is expected."""
        if not re.fullmatch(r"[+-]?\d+", raw) or not cls.least <= int(raw) <= cls.most:
            raise ValueError(f"{raw} is not {cls.expects}")
        return cls(raw)


class Quantity(Text):
    """Kubernetes' resource quantity: 250m, 1, 0.5, 64Mi, 2G."""

    kind = "bad-quantity"
    expects = "a quantity such as 250m, 0.5, 64Mi or 2G"
    pattern = re.compile(r"\+?(\d+(\.\d*)?|\.\d+)([numkMGTPE]|[KMGTPE]i|[eE][+-]?\d+)?")


class Port(Number):
    """A TCP or UDP port."""

    kind = "bad-port"
    expects = "a port: a whole number from 1 to 65535"
    least, most = 1, 65535

    @staticmethod
    def explain(raw: str) -> str:
        """Return what to write instead of a port of docker compose, "" for another text."""
        if not (found := re.fullmatch(r"(?:(\d+):)?(\d+)(?:/(tcp|udp))?", raw)):
            return ""
        other = f", service_port: {found[1]}" if found[1] not in (None, found[2]) else ""
        other += ", protocol: UDP" if found[3] == "udp" else ""
        return f": write {{port: {found[2]}{other}}}" if other else f": write {found[2]}"


class Replicas(Number):
    """How many pods."""

    kind = "bad-replicas"
    expects = "a number of pods: 0 or more"


class Count(Number):
    """How many, or how many seconds; at least one."""

    kind = "bad-number"
    expects = "a whole number, at least 1"
    least = 1


class Servers(Number):
    """How many discovery servers; Fast DDS counts them in one byte."""

    kind = "bad-number"
    expects = "a number of servers from 1 to 255"
    least, most = 1, 255


class Delay(Number):
    """Whole seconds; 0 is allowed."""

    kind = "bad-number"
    expects = "whole seconds, 0 or more"


class Share(Text):
    """A number of pods or a percentage of them, as Kubernetes writes both in one field."""

    kind = "bad-share"
    expects = 'a number of pods such as 1, or a percentage such as "25%"'
    pattern = re.compile(r"\d+%?")

    @property
    def value(self) -> int | str:
        """The value for the Kubernetes field; a template that is not rendered yet stays a text."""
        return int(self) if self.isdecimal() else str(self)


class ImageRef(Text):
    """A container image: [HOST[:PORT]/]PATH[:TAG][@DIGEST]."""

    kind = "bad-image"
    expects = "an image reference such as ros:noetic or registry.example:5000/team/app:1.2"

    @classmethod
    def parse(cls, raw: str) -> ImageRef:
        """Return the reference; upper case in the path, a common mistake, has its own message."""
        if is_reference(raw):
            return cls(raw)
        if is_reference(raw.lower()):
            raise ValueError(f'"{raw}" is not an image reference: its path must be lower case')
        raise ValueError(f'"{raw}" is not {cls.expects}')


class ObjectName(Text):
    """A name of a Kubernetes object that also serves as a DNS label."""

    kind = "bad-name"
    expects = 'a Kubernetes name: lower case letters, digits and "-", a letter or digit at each end'
    pattern = re.compile(r"[a-z0-9]([-a-z0-9]*[a-z0-9])?")
    longest = 63


class VolumeName(ObjectName):
    """The name of a persistent volume."""

    @classmethod
    def parse(cls, raw: str) -> VolumeName:
        """Return the name; what docker compose writes has its own message."""
        if found := re.fullmatch(r"([^:]+):(/[^:]*)(:\w+)?", raw):
            source, inside = found[1], found[2]
            other = (
                f"{{{'host_path' if source[0] == '/' else 'name'}: {source}, mount_path: {inside}}}"
            )
            if source[0] in ".~":
                other = f"`files: {{{inside}: {source}}}`"
            raise ValueError(f'"{raw}" is not the name of a volume: write {other}')
        return super().parse(raw)


class DottedName(Text):
    """A name of a Kubernetes object that may contain dots: a DNS subdomain."""

    kind = "bad-name"
    expects = 'a Kubernetes name: lower case letters, digits, "-" and "."'
    pattern = re.compile(r"[a-z0-9]([-a-z0-9]*[a-z0-9])?(\.[a-z0-9]([-a-z0-9]*[a-z0-9])?)*")
    longest = 253


class PortName(Text):
    """A port's name: what Kubernetes calls an IANA service name."""

    kind = "bad-name"
    expects = 'a port name: at most 15 lower case letters, digits and "-", one of them a letter'
    pattern = re.compile(r"(?=.*[a-z])(?!.*--)[a-z0-9]([a-z0-9-]*[a-z0-9])?")
    longest = 15


LABEL = r"[A-Za-z0-9]([-A-Za-z0-9_.]{0,61}[A-Za-z0-9])?"


class LabelKey(Text):
    """A label's key: [PREFIX/]NAME."""

    kind = "bad-label"
    expects = 'a label key such as robot or example.com/robot (letters, digits, "-", "_", ".")'
    pattern = re.compile(rf"([a-z0-9]([-a-z0-9.]*[a-z0-9])?/)?{LABEL}")


class LabelValue(Text):
    """A label's value."""

    kind = "bad-label"
    expects = 'a label value: at most 63 letters, digits, "-", "_" and "."'
    pattern = re.compile(rf"({LABEL})?")


class EnvName(Text):
    """The name of an environment variable."""

    kind = "bad-env"
    expects = "a name of an environment variable: letters, digits and _, no digit first"
    nested: ClassVar[str] = ": write `env` as a list, [{name: %s, valueFrom: ...}]"
    pattern = re.compile(r"[A-Za-z_][A-Za-z0-9_]*")


class MountPath(Text):
    """An absolute path inside a container or on a machine."""

    kind = "bad-path"
    expects = "an absolute path such as /data, without a colon"
    pattern = re.compile(r"/[^:\0]*")


class DevicePath(Text):
    """A path of a machine's device; those by-path have colons, which no path in a pod may have."""

    kind = "bad-path"
    expects = "an absolute path such as /dev/ttyUSB0"
    pattern = re.compile(r"/[^\0*?]*")

    @classmethod
    def parse(cls, raw: str) -> DevicePath:
        """Return the path; what docker compose writes has its own message."""
        if found := re.fullmatch(r"(/[^:]*):(/[^:]*)(:[rwm]+)?", raw):
            path, inside = found[1], found[2]
            other = path if path == inside else f"{{path: {path}, mount_path: {inside}}}"
            raise ValueError(f'"{raw}" is not {cls.expects}: write {other}')
        if re.fullmatch(r"[a-z0-9.-]+\.[a-z]+/\w+(=\w+)?", raw):
            resource = raw.partition("=")[0]
            raise ValueError(f'"{raw}" is not {cls.expects}: write {{resource: {resource}}}')
        return super().parse(raw)

    @property
    def inside(self) -> str:
        """The path in a container."""
        return self.replace(":", "_")


class RosName(Text):
    """A ROS graph resource name of any generation; each has rules of its own (rosnames.py)."""

    kind = "bad-ros-name"
    expects = "a ROS name: letters, digits, _ and /, starting with a letter or /"
    pattern = re.compile(r"/?_?[A-Za-z][A-Za-z0-9_]*(/_?[A-Za-z][A-Za-z0-9_]*)*|/")

    @classmethod
    def parse(cls: type[R], raw: str) -> R:
        """Return the name; a hyphen, a common mistake, has its own message."""
        if "-" in raw and cls.pattern.fullmatch(raw.replace("-", "_")):
            raise ValueError(f'"{raw}" is not a ROS name: ROS has no "-", write "_"')
        return super().parse(raw)


class RemapName(RosName):
    """One side of a remapping, as any generation of ROS reads it."""

    pattern = re.compile(
        r"([A-Za-z0-9_]+:)?(rostopic://|rosservice://)?(~/?|/)?[A-Za-z0-9_]+(/[A-Za-z0-9_]+)*/?"
    )


class RosUri(Text):
    """The URI of a ROS master."""

    kind = "bad-uri"
    expects = "a ROS master's URI such as http://robot:11311"
    pattern = re.compile(r"http://[A-Za-z0-9._\[\]:-]+:\d{1,5}/?")


class Url(Text):
    """The URL of a server."""

    kind = "bad-url"
    expects = "a URL such as http://loki.logging:3100"
    pattern = re.compile(r"https?://[A-Za-z0-9._\[\]:-]+(/\S*)?")


class HostPort(Text):
    """The address of a server."""

    kind = "bad-address"
    expects = "an address HOST:PORT such as alertmanager.monitoring:9093"
    pattern = re.compile(r"[A-Za-z0-9._\[\]-]+:\d{1,5}")


class Duration(Text):
    """A duration: 30, 30s, 5m, 1h30m, 500ms."""

    kind = "bad-duration"
    expects = "a duration such as 30s, 5m or 1h30m"
    pattern = re.compile(r"(?=.)(\d+h)?(\d+m(?!s))?(\d+(\.\d+)?s?)?|\d+ms")

    @classmethod
    def parse(cls, raw: str) -> Duration:
        """Return the duration; zero is refused, since nothing would be waited for."""
        value = super().parse(raw)
        if not value.seconds:
            raise ValueError(f'"{raw}" is not {cls.expects}')
        return value

    @property
    def seconds(self) -> float:
        units = {"h": 3600.0, "m": 60.0, "s": 1.0, "ms": 1e-3, "": 1.0}
        parts = re.findall(r"(\d+(?:\.\d+)?)(ms|[hms]?)", self)
        return sum(float(number) * units[unit] for number, unit in parts)


#: A rate that is one number may differ by this part of it.
SPREAD = 0.2


class Range(Text):
    """What a number may be: 2, 8..12, 8.., ..12."""

    kind = "bad-range"
    expects = "a number, or a range such as 8..12, 8.. or ..12"
    pattern = re.compile(r"(?=.*\d)(\d+(\.\d+)?)?(\.\.(\d+(\.\d+)?)?)?")

    @classmethod
    def parse(cls, raw: str) -> Range:
        """Return the range; one that is empty is refused."""
        value = super().parse(raw)
        if value.limits[0] > value.limits[1]:
            raise ValueError(f'"{raw}" is not {cls.expects}: the lower number comes first')
        return value

    @property
    def limits(self) -> tuple[float, float]:
        """The lowest and the highest, both allowed."""
        low, dots, high = self.partition("..")
        if not dots:
            return float(low), float(low)
        return float(low or 0), float(high or "inf")

    @property
    def around(self) -> tuple[float, float]:
        """The limits; of one number, a fifth less and a fifth more."""
        low, high = self.limits
        return (low, high) if low < high else (low * (1 - SPREAD), high * (1 + SPREAD))


class Retention(Text):
    """A duration as Prometheus and Loki write it: larger units first."""

    kind = "bad-duration"
    expects = "a duration such as 15s, 12h, 7d or 1d12h"
    pattern = re.compile(r"(?=.)(\d+y)?(\d+w)?(\d+d)?(\d+h)?(\d+m)?(\d+s)?(\d+ms)?|0")

    @property
    def seconds(self) -> float:
        units = {"y": 31_536_000, "w": 604_800, "d": 86_400, "h": 3600, "m": 60, "s": 1, "ms": 1e-3}
        return sum(float(n) * units[u] for n, u in re.findall(r"(\d+)(ms|[smhdwy])", self))
