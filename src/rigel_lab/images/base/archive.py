"""Layers to one file that podman, docker and containerd load; knows nothing of ROS.

The file is an OCI image layout and a docker archive at once: both indexes point to the same blobs,
so old and new engines read it without conversion.
"""

from __future__ import annotations

import hashlib
import io
import json
import platform
import tarfile
from collections.abc import Mapping, Sequence
from datetime import datetime, timezone
from pathlib import Path
from typing import Any

__all__ = ["FORMAT", "architecture", "digest_of", "write"]

#: Another one where the same layers give another file.
FORMAT = "2"

_OCI = "application/vnd.oci.image"
_CHUNK = 1 << 20


def write(
    target: Path, layers: Sequence[Path], config: Mapping[str, Any], reference: str, *, created: int
) -> str:
    """Write an image of uncompressed layer tars and return its id (the configuration's digest).

    Args:
        target: the archive to write; it appears only when it is complete.
        layers: layer tars, the lowest first.
        config: the `config` of an OCI image configuration: Entrypoint, Cmd, Env.
        reference: the name that engines give the image when they load it.
        created: seconds since 1970; the same input gives the same bytes.
    """
    digests = [digest_of(path) for path in layers]
    image = _json(_image(config, digests, created))
    manifest = _json(_manifest(image, layers, digests))
    partial = target.with_suffix(".partial")
    with tarfile.open(partial, "w", format=tarfile.PAX_FORMAT) as tar:
        for path, digest in zip(layers, digests, strict=True):
            _add_file(tar, _blob(digest), path, created)
        for name, content in _small_files(image, manifest, digests, reference):
            _add_bytes(tar, name, content, created)
    partial.replace(target)
    return _digest(image)


def architecture() -> str:
    """Return this machine's architecture as images name it."""
    machine = platform.machine()
    return {"x86_64": "amd64", "aarch64": "arm64", "armv7l": "arm"}.get(machine, machine)


def digest_of(path: Path) -> str:
    """Return the sha256 of a file, in hex."""
    found = hashlib.sha256()
    with path.open("rb") as file:
        while chunk := file.read(_CHUNK):
            found.update(chunk)
    return found.hexdigest()


def _image(config: Mapping[str, Any], digests: Sequence[str], created: int) -> dict[str, Any]:
    moment = datetime.fromtimestamp(created, timezone.utc).strftime("%Y-%m-%dT%H:%M:%SZ")
    return {
        "architecture": architecture(),
        "os": "linux",
        "created": moment,
        "config": dict(config),
        "rootfs": {"type": "layers", "diff_ids": [f"sha256:{d}" for d in digests]},
        # buildah refuses to build on an image whose history does not count its layers.
        "history": [{"created": moment, "created_by": "rigel-k8s"} for _ in digests],
    }


def _manifest(image: bytes, layers: Sequence[Path], digests: Sequence[str]) -> dict[str, Any]:
    return {
        "schemaVersion": 2,
        "mediaType": f"{_OCI}.manifest.v1+json",
        "config": _descriptor(f"{_OCI}.config.v1+json", _digest(image), len(image)),
        "layers": [
            _descriptor(f"{_OCI}.layer.v1.tar", digest, path.stat().st_size)
            for path, digest in zip(layers, digests, strict=True)
        ],
    }


def _small_files(
    image: bytes, manifest: bytes, digests: Sequence[str], reference: str
) -> list[tuple[str, bytes]]:
    """Everything but the layers: the blobs, then the OCI index and the docker index."""
    named = {
        **_descriptor(f"{_OCI}.manifest.v1+json", _digest(manifest), len(manifest)),
        "annotations": {
            "io.containerd.image.name": reference,
            "org.opencontainers.image.ref.name": reference.rpartition(":")[2],
        },
    }
    docker = {
        "Config": _blob(_digest(image)),
        "RepoTags": [reference],
        "Layers": [_blob(d) for d in digests],
    }
    return [
        (_blob(_digest(image)), image),
        (_blob(_digest(manifest)), manifest),
        ("oci-layout", _json({"imageLayoutVersion": "1.0.0"})),
        ("index.json", _json({"schemaVersion": 2, "manifests": [named]})),
        ("manifest.json", _json([docker])),
    ]


def _descriptor(media_type: str, digest: str, size: int) -> dict[str, Any]:
    return {"mediaType": media_type, "digest": f"sha256:{digest}", "size": size}


def _blob(digest: str) -> str:
    return f"blobs/sha256/{digest}"


def _digest(content: bytes) -> str:
    return hashlib.sha256(content).hexdigest()


def _json(value: object) -> bytes:
    return json.dumps(value, sort_keys=True, separators=(",", ":")).encode()


def _add_file(tar: tarfile.TarFile, name: str, path: Path, created: int) -> None:
    with path.open("rb") as file:
        tar.addfile(_member(name, path.stat().st_size, created), file)


def _add_bytes(tar: tarfile.TarFile, name: str, content: bytes, created: int) -> None:
    tar.addfile(_member(name, len(content), created), io.BytesIO(content))


def _member(name: str, size: int, created: int) -> tarfile.TarInfo:
    info = tarfile.TarInfo(name)
    info.size, info.mtime, info.mode = size, created, 0o644
    return info
