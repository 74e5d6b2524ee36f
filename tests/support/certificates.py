"""Certificates of authorities and servers, made by openssl."""

from __future__ import annotations

import subprocess
from pathlib import Path

import attrs

#: No extensions but these: what authorities of EKS and of older MicroK8s have.
BARE = "[req]\ndistinguished_name = dn\n[dn]\n"
AUTHORITY = "basicConstraints=critical,CA:TRUE\n"
SERVER = "subjectAltName=IP:127.0.0.1\n"


@attrs.frozen
class Authority:
    """Keys and certificates in a directory, made by openssl."""

    directory: Path

    def make(self, name: str, extensions: str, by: str | None = None) -> Path:
        """Return a certificate's file, signed by another one or by itself."""
        config, asked = self.directory / "config", self.directory / f"{name}.asked"
        config.write_text(BARE)
        (self.directory / "extensions").write_text(extensions)
        key, pem = self.directory / f"{name}.key", self.directory / f"{name}.pem"
        kind = ["-newkey", "ec", "-pkeyopt", "ec_paramgen_curve:P-256", "-nodes"]
        run(
            "req",
            "-new",
            *kind,
            "-config",
            config,
            "-subj",
            f"/CN={name}",
            "-keyout",
            key,
            "-out",
            asked,
        )
        signer = ["-CA", f"{by}.pem", "-CAkey", f"{by}.key", "-CAcreateserial"]
        run(
            "x509",
            "-req",
            "-in",
            asked,
            "-days",
            "1",
            "-out",
            pem,
            "-extfile",
            "extensions",
            *(signer if by else ["-signkey", key]),
            cwd=self.directory,
        )
        return pem


def run(*words: str | Path, cwd: Path | None = None) -> None:
    subprocess.run(["openssl", *words], check=True, capture_output=True, cwd=cwd)
