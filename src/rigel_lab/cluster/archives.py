"""Image archives that others made, put into a cluster's registry as they are.

An archive is an OCI image layout in a tar file, with one image in it.
"""

from __future__ import annotations

import json
import tarfile
from pathlib import Path
from typing import Any

import attrs
import urllib3

from rigel_lab.cluster.oci import put_blob, refuse

__all__ = ["push_archive"]


@attrs.frozen
class Archive:
    """An archive that is open for reading."""

    tar: tarfile.TarFile

    def described(self, name: str) -> Any:
        """Return the content of a JSON file inside."""
        with self.tar.extractfile(name) as file:  # type: ignore[union-attr]
            return json.load(file)

    def put(self, http: urllib3.PoolManager, base: str, part: dict[str, Any]) -> None:
        """Upload the part that a descriptor names, without holding all of it in memory."""
        with self.tar.extractfile(blob(part["digest"])) as file:  # type: ignore[union-attr]
            put_blob(http, base, part["digest"], file, part["size"])


def push_archive(path: Path, name: str, registry: str) -> bool:
    """Push the image of an archive to `registry` (HOST:PORT, plain HTTP) as `registry/name`.

    Returns:
        Whether anything was to be pushed: not so where that very image has the name there.

    Raises:
        LocalClusterError: the registry refused a part.
    """
    repository, tag = name.rsplit(":", 1)
    base = f"http://{registry}/v2/{repository}"
    http = urllib3.PoolManager(retries=False)
    with tarfile.open(path) as tar:
        archive = Archive(tar)
        image = archive.described("index.json")["manifests"][0]
        kind = image["mediaType"]
        there = http.request("HEAD", f"{base}/manifests/{tag}", headers={"Accept": kind})
        if there.headers.get("Docker-Content-Digest") == image["digest"]:
            return False
        manifest = archive.described(blob(image["digest"]))
        for part in (manifest["config"], *manifest["layers"]):
            archive.put(http, base, part)
        with tar.extractfile(blob(image["digest"])) as file:  # type: ignore[union-attr]
            text = file.read()
    headers = {"Content-Type": kind}
    refuse(http.request("PUT", f"{base}/manifests/{tag}", body=text, headers=headers), name)
    return True


def blob(digest: str) -> str:
    """Return where an archive has what a digest names."""
    return f"blobs/{digest.replace(':', '/')}"
