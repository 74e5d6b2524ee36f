"""What helps where docker and podman fail."""

from __future__ import annotations

import os
import threading

import pytest

from rigel_k8s.errors import CommandFailed
from rigel_k8s.images.process import hint, stream


def test_a_known_failure_of_a_program_has_a_way_out() -> None:
    """The error keeps what failed and the last lines, and says what helps."""
    words = ["sh", "-c", "echo 1; echo unauthorized: authentication required >&2; exit 125"]
    with pytest.raises(CommandFailed, match=r"^the push failed \(exit code 125\)$") as caught:
        stream(words, what="the push", env=os.environ, cancel=threading.Event())
    assert caught.value.details == ("1", "unauthorized: authentication required")
    assert "registry provider" in str(caught.value.hint)


@pytest.mark.parametrize(
    ("line", "way"),
    [
        ("http: server gave HTTP response to HTTPS client", "insecure: true"),
        ("x509: certificate signed by unknown authority", "insecure: true"),
        ("unauthorized: authentication required", "registry provider"),
        ("denied: requested access to the resource is denied", "registry provider"),
        ("exec /bin/sh: exec format error", "qemu-user-static"),
    ],
)
def test_known_failures_have_a_way_out(line: str, way: str) -> None:
    """What docker and podman say often is answered with what to do."""
    assert way in str(hint(["first", line, "last"]))
    assert hint(["something else"]) is None
