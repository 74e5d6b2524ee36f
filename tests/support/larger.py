"""Images that no machine has: one of the cluster's registry, with more in it."""

from __future__ import annotations

import io
import os
import uuid
from typing import Any

import attrs
import urllib3

from rigel_k8s.system import oci
from rigel_lab.cluster.oci import Image, push


@attrs.frozen
class Larger(Image):
    """An image that is assembled already."""

    assembled: oci.Image | None = None

    def parts(self) -> oci.Image:
        assert self.assembled
        return self.assembled


def push_larger(image: str, mebibytes: int) -> str:
    """Push an image of a registry (HOST:PORT/NAME:TAG, plain HTTP) again, larger by random bytes.

    Returns:
        The new image: in the same repository, where its lower layers are.
    """
    registry, _, name = image.partition("/")
    repository, _, tag = name.rpartition(":")
    http = urllib3.PoolManager(retries=False)

    def read(path: str, kind: str = "*/*") -> dict[str, Any]:
        url = f"http://{registry}/v2/{repository}/{path}"
        return dict(http.request("GET", url, headers={"Accept": kind}).json())

    manifest = read(f"manifests/{tag}", "application/vnd.oci.image.manifest.v1+json")
    config = read(f"blobs/{manifest['config']['digest']}")["config"]
    there = [
        oci.Blob(*(o[k] for k in ("mediaType", "digest", "size")), io.BytesIO)
        for o in manifest["layers"]
    ]
    more = oci.layer([oci.Entry("more", os.urandom(mebibytes << 20))], mtime=0)
    made = oci.assemble(config, [*there, oci.blob(oci.UNCOMPRESSED, more)])
    larger = f"{repository}:larger-{uuid.uuid4().hex[:8]}"
    push(Larger(larger, {}, (), assembled=made), registry)
    return f"{registry}/{larger}"
