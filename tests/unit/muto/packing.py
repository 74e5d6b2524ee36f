"""Archives as stacks carry them, packed by the tests."""

from __future__ import annotations

import base64
import hashlib
import io
import tarfile
import zipfile
from typing import Any

#: A workspace: two packages and a launch file beside them.
LAUNCH = "launch/eyes.launch.xml"
WORKSPACE = {
    LAUNCH: "<launch/>",
    "src/left/package.xml": "<package><name>left</name></package>",
    "src/left/scripts/look.py": "#!/usr/bin/env python3\n",
    "src/right/package.xml": "<package><name>right</name></package>",
}


def make_member(name: str, content: bytes = b"", **more: Any) -> tuple[tarfile.TarInfo, bytes]:
    """Return an entry of a tar; `more` are attributes of its TarInfo."""
    info = tarfile.TarInfo(name)
    info.size = len(content)
    info.mode = 0o755 if name.endswith((".py", ".sh")) else 0o644
    for key, value in more.items():
        setattr(info, key, value)
    return info, content


def make_tar(*members: tuple[tarfile.TarInfo, bytes], compression: str = "gz") -> bytes:
    """Return a tar of entries."""
    packed = io.BytesIO()
    with tarfile.open(fileobj=packed, mode=f"w:{compression}") as archive:  # type: ignore[call-overload]
        for info, content in members:
            archive.addfile(info, io.BytesIO(content))
    return packed.getvalue()


def pack(files: dict[str, str], compression: str = "gz") -> bytes:
    """Return a tar with files by their names."""
    members = (make_member(name, text.encode()) for name, text in files.items())
    return make_tar(*members, compression=compression)


def pack_zip(files: dict[str, str]) -> bytes:
    """Return a zip with files by their names, as Unix packs it."""
    packed = io.BytesIO()
    with zipfile.ZipFile(packed, "w") as archive:
        for name, text in files.items():
            info = zipfile.ZipInfo(name)
            info.external_attr = (0o100755 if name.endswith((".py", ".sh")) else 0o100644) << 16
            archive.writestr(info, text, zipfile.ZIP_DEFLATED)
    return packed.getvalue()


def make_stack(content: bytes, **properties: Any) -> dict[str, Any]:
    """Return a stack of the form stack/archive."""
    more = {
        "algorithm": "sha256",
        "checksum": hashlib.sha256(content).hexdigest(),
        "launch_file": LAUNCH,
        "command": "launch",
        "launch_args": [{"name": "side", "default": "left"}],
        "ros_args": [],
        "flatten": True,
    }
    return {
        "metadata": {"name": "Two Eyes", "content_type": "stack/archive"},
        "launch": {
            "data": base64.b64encode(content).decode(),
            "properties": {**more, **properties},
        },
    }
