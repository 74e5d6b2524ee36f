"""Keys and certificates of a cluster, made with the openssl program; independent of processes."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from rigel_lab.cluster.commands import run

DAYS = "3650"


class Authority:
    """A certificate authority in a directory; its files are NAME.crt and NAME.key."""

    def __init__(self, directory: Path, name: str = "ca") -> None:
        self.directory = directory
        self.name = name
        self.certificate = directory / f"{name}.crt"
        directory.mkdir(mode=0o700, parents=True, exist_ok=True)
        if not self.certificate.exists():
            self._create()

    def _create(self) -> None:
        key = make_key(self.directory / f"{self.name}.key")
        run(
            ["openssl", "req", "-x509", "-new", "-key", str(key), "-sha256", "-days", DAYS]
            + ["-subj", f"/CN=rigel-k8s {self.name}", "-out", str(self.certificate)]
            + ["-addext", "basicConstraints=critical,CA:TRUE"]
            + ["-addext", "keyUsage=critical,keyCertSign,cRLSign,digitalSignature"]
        )

    def issue(
        self,
        name: str,
        common_name: str,
        *,
        organization: str | None = None,
        alternatives: Sequence[str] = (),
    ) -> tuple[Path, Path]:
        """Return (certificate, key) files of a client, or of a server if it has alternatives.

        alternatives: subject alternative names as openssl writes them, `DNS:x` or `IP:y`.
        """
        certificate, key = self.directory / f"{name}.crt", self.directory / f"{name}.key"
        if certificate.exists():
            return certificate, key
        make_key(key)
        subject = (f"/O={organization}" if organization else "") + f"/CN={common_name}"
        request, extensions = self.directory / f"{name}.csr", self.directory / f"{name}.ext"
        usage = "extendedKeyUsage=clientAuth,serverAuth\nkeyUsage=critical,digitalSignature\n"
        if alternatives:
            usage += f"subjectAltName={','.join(alternatives)}\n"
        extensions.write_text(usage)
        run(["openssl", "req", "-new", "-key", str(key), "-subj", subject, "-out", str(request)])
        run(
            ["openssl", "x509", "-req", "-in", str(request), "-sha256", "-days", DAYS]
            + ["-CA", str(self.certificate), "-CAkey", str(self.directory / f"{self.name}.key")]
            + ["-CAcreateserial", "-extfile", str(extensions), "-out", str(certificate)]
        )
        request.unlink()
        extensions.unlink()
        return certificate, key


def make_key(path: Path) -> Path:
    """Make an elliptic-curve key (P-256) that only its owner can read."""
    path.touch(mode=0o600)
    run(["openssl", "ecparam", "-name", "prime256v1", "-genkey", "-noout", "-out", str(path)])
    path.chmod(0o600)
    return path


def service_account_key(directory: Path) -> tuple[Path, Path]:
    """Return (private, public) key files that sign service-account tokens."""
    private, public = directory / "sa.key", directory / "sa.pub"
    if not public.exists():
        make_key(private)
        run(["openssl", "ec", "-in", str(private), "-pubout", "-out", str(public)])
    return private, public
