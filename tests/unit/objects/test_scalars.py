"""Values that Kubernetes or ROS would refuse are refused with what would do."""

from __future__ import annotations

import pytest

from rigel_k8s.objects import scalars

CLASSES = {
    name
    for name, found in vars(scalars).items()
    if isinstance(found, type)
    and issubclass(found, scalars.Text | scalars.Number)
    and found not in (scalars.Text, scalars.Number)
}
GOOD = {
    "Quantity": ["250m", "1", "0.5", "64Mi", "2G", "1e3", ".5", "+1"],
    "Port": ["1", "65535"],
    "Replicas": ["0", "100"],
    "Count": ["1"],
    "Servers": ["1", "255"],
    "Delay": ["0"],
    "Share": ["0", "1", "25%"],
    "ImageRef": [
        "ros:noetic",
        "app",
        "registry.example:5000/team/app_x:1.2-rc.1",
        "localhost/a@sha256:" + "0a" * 32,
        "[::1]:5000/a",
        "ghcr.io/A/b".lower(),
    ],
    "ObjectName": ["a", "a-b1", "1a", "a" * 63],
    "DottedName": [
        "a",
        "robot-1.lan",
        "ip-10-0-1-5.eu-west-1.compute.internal",
        "kube-root-ca.crt",
    ],
    "PortName": ["http", "a1", "1a"],
    "LabelKey": ["a", "example.com/Robot_1.x", "nvidia.com/gpu"],
    "LabelValue": ["", "a", "A_b.c-1"],
    "EnvName": ["A", "_a1"],
    "MountPath": ["/", "/a/b c"],
    "VolumeName": ["a", "maps-1"],
    "DevicePath": ["/dev/a", "/dev/serial/by-path/pci-0000:00:14.0-usb-0:2:1.0-port0"],
    "RosName": ["a", "/a/b_1", "/", "/a/_action/status"],
    "RemapName": ["a", "/a/b_1", "~a", "~/a", "n:~/a", "rostopic:///a", "/1a"],
    "RosUri": ["http://robot:11311", "http://10.0.0.1:11311/", "http://[::1]:11311"],
    "Url": ["http://loki.logging:3100", "https://loki/a?b", "http://[::1]:9090"],
    "HostPort": ["alertmanager.monitoring:9093", "10.0.0.1:9093"],
    "Duration": ["30", "30s", "5m", "1h30m", "0.5s", "500ms"],
    "Range": ["2", "0.5", "8..12", "8..", "..12", "3..3"],
    "Retention": ["15s", "7d", "1h30m", "500ms"],
}
BAD = {
    "Quantity": ["", "1 Gi", "64mb", "-1", "1.2.3", "Mi"],
    "Port": ["0", "65536", "http", "1.5", ""],
    "Replicas": ["-1", "two"],
    "Count": ["0"],
    "Servers": ["0", "256"],
    "Delay": ["-1"],
    "Share": ["-1", "a", "25 %", ""],
    "ImageRef": [
        *("", "Ros:noetic", "a:b:c", "a b", "a@sha256:1", "/a", "a//b", "http://a/b"),
        *("host.x_y/a", "a/" + "b" * 254),
    ],
    "ObjectName": ["", "a_b", "A", "-a", "a-", "a.b", "a" * 64],
    "DottedName": ["", "a_b", "A", "-a", "a.", "a..b", "a" * 254],
    "PortName": ["", "80", "a--b", "sixteen-letters-x", "A"],
    "LabelKey": ["", "a b", "-a", "a/b/c", "Example.com/a", "a" * 64],
    "LabelValue": ["a b", "-a", "a" * 64, "ä"],
    "EnvName": ["", "1a", "a-b", "a b"],
    "MountPath": ["", "a", "./a", "/a:b"],
    "VolumeName": ["", "a_b", "/a", "a:b", "/a:/b"],
    "DevicePath": ["", "dev/a", "/dev/a:/dev/b", "/dev/a:/dev/b:rwm", "/dev/ttyUSB*"],
    "RosName": ["", "a-b", "1a", "a//b", "a b", "a/", "ä", "~a", "~/a"],
    "RemapName": ["", "a-b", "a//b", "a b", "ä", "*", "~", "/", "a:b:c"],
    "RosUri": ["robot:11311", "http://robot", "https://robot:1", "http://robot:11311/x"],
    "Url": ["", "loki:3100", "there", "ftp://a", "http://a b"],
    "HostPort": ["", "nobody", "http://a:1", "a:"],
    "Duration": ["", "0", "0s", "five", "1d", "-1s", "5 m", "5m500ms", "0ms"],
    "Range": ["", "..", "12..8", "8-12", "8...12", "-1", "ten"],
    "Retention": ["", "7", "week"],
}


@pytest.mark.parametrize(("kind", "text"), [(k, t) for k, ts in GOOD.items() for t in ts])
def test_good_values_are_kept_as_they_are(kind: str, text: str) -> None:
    """parse changes nothing but the type."""
    value = getattr(scalars, kind).parse(text)
    assert str(value) == text
    assert isinstance(value, getattr(scalars, kind))


@pytest.mark.parametrize(("kind", "text"), [(k, t) for k, ts in BAD.items() for t in ts])
def test_bad_values_are_refused_with_what_would_do(kind: str, text: str) -> None:
    """The message has the value in it."""
    with pytest.raises(ValueError, match=r"is not|too long") as caught:
        getattr(scalars, kind).parse(text)
    assert text in str(caught.value)


def test_every_class_has_its_table() -> None:
    """A new scalar needs both tables here, a slug and a description."""
    assert set(GOOD) == set(BAD) == CLASSES
    for name in CLASSES:
        assert getattr(scalars, name).kind.startswith("bad-")
        assert getattr(scalars, name).expects


def test_the_usual_mistakes_get_a_hint() -> None:
    """Hyphens in ROS names, capitals in images."""
    with pytest.raises(ValueError, match='write "_"'):
        scalars.RosName.parse("my-node")
    with pytest.raises(ValueError, match="lower case"):
        scalars.ImageRef.parse("Team/App:1")


@pytest.mark.parametrize(
    ("kind", "text", "other"),
    [
        ("VolumeName", "/data:/data:ro", "{host_path: /data, mount_path: /data}"),
        ("VolumeName", "maps:/maps", "{name: maps, mount_path: /maps}"),
        ("VolumeName", "./maps:/maps", "`files: {/maps: ./maps}`"),
        ("DevicePath", "/dev/a:/dev/b:rwm", "{path: /dev/a, mount_path: /dev/b}"),
        ("DevicePath", "nvidia.com/gpu=all", "{resource: nvidia.com/gpu}"),
    ],
)
def test_what_docker_compose_writes_is_told(kind: str, text: str, other: str) -> None:
    with pytest.raises(ValueError, match="is not") as caught:
        getattr(scalars, kind).parse(text)
    assert str(caught.value).endswith(f"write {other}")


def test_durations_in_seconds() -> None:
    """Hours, minutes and seconds add up; a bare number is seconds."""
    texts = ["30", "1h30m", "0.5s", "2m5s"]
    assert [scalars.Duration(t).seconds for t in texts] == [30, 5400, 0.5, 125]


def test_retentions_in_seconds() -> None:
    """Years to milliseconds, as Prometheus counts them."""
    texts = ["1y", "1w2d", "1h30m", "15s", "500ms"]
    found = [scalars.Retention(text).seconds for text in texts]
    assert found == [365 * 86_400, 9 * 86_400, 5400, 15, 0.5]


def test_shares_are_numbers_or_percentages() -> None:
    """Kubernetes tells an integer from text."""
    assert [scalars.Share(t).value for t in ("1", "25%")] == [1, "25%"]
