"""Which broker to connect to, and how to log in there."""

from __future__ import annotations

import ssl
from pathlib import Path
from urllib.parse import urlsplit

import attrs

from rigel_k8s.errors import UserError
from rigel_k8s.system.tls import is_loopback, trust

PORTS = {"mqtt": 1883, "mqtts": 8883}


@attrs.frozen
class Address:
    """Where a broker is."""

    host: str
    port: int
    tls: bool

    @property
    def is_readable_by_others(self) -> bool:
        """Whether others can read what is sent there: unencrypted, to another machine."""
        return not self.tls and self.host != "localhost" and not is_loopback(self.host)

    def __str__(self) -> str:
        host = f"[{self.host}]" if ":" in self.host else self.host
        return f"{'mqtts' if self.tls else 'mqtt'}://{host}:{self.port}"


def read_address(text: str) -> Address:
    """Return the broker of a URL, mqtt://HOST[:PORT] or mqtts://HOST[:PORT].

    Raises:
        UserError: it is not such a URL.
    """
    hint = "expected mqtt://HOST, or mqtts://HOST for TLS, with :PORT if it is not 1883 or 8883"
    try:
        parts = urlsplit(text)
        host, port = parts.hostname, parts.port
        (host or "").encode("idna")  # as a connection does
    except ValueError as error:
        raise UserError(f'"{text}" is not the address of a broker: {error}', hint=hint) from error
    if parts.username is not None or parts.password is not None:
        raise UserError(
            "the address of the broker has a user or a password in it",
            hint="put them into files, `username` and `password`",
        )
    if parts.scheme not in PORTS or not host or port == 0 or parts.path.strip("/") or parts.query:
        raise UserError(f'"{text}" is not the address of a broker', hint=hint)
    return Address(host, port or PORTS[parts.scheme], parts.scheme == "mqtts")


@attrs.frozen(kw_only=True)
class Login:
    """How to log in. Files are read again for each connection, since Secrets change.

    Attributes:
        password_file: the file with the password; a line's end is not part of it.
        authorities: the file with the certificates that the broker's must be signed by; None for
            those that this machine trusts.
        certificate, key: files with the client's own certificate.
    """

    user: str | None = None
    password_file: Path | None = None
    authorities: Path | None = None
    certificate: Path | None = None
    key: Path | None = None

    def __attrs_post_init__(self) -> None:
        if self.password_file and not self.user:
            raise UserError("there is a password for the broker, and no user")
        if (self.certificate is None) != (self.key is None):
            raise UserError("a client's certificate and its key belong together: set both")

    def read_password(self) -> str | None:
        """Return the password, None without one. Raises UserError if it cannot be read."""
        if self.password_file:
            return _read_text(self.password_file, "the broker's password").rstrip("\r\n")
        return None

    def make_context(self) -> ssl.SSLContext:
        """Return the settings of TLS.

        Raises:
            UserError: a file cannot be read, or has no certificates in it.
        """
        # An empty text would stand for the authorities of this machine.
        authorities = (self._read_authorities() or "\n") if self.authorities else ""
        try:
            context = trust(authorities, protocols=())
        except (ssl.SSLError, ValueError) as error:
            raise UserError(f"{self.authorities} has no certificates in it: {error}") from error
        self._load_certificate(context)
        return context

    def load_files(self, context: ssl.SSLContext) -> None:
        """Put what the files have now into settings of TLS: an authority beside those before it.

        Raises:
            UserError: a file cannot be read or used.
        """
        if self.authorities:
            try:
                context.load_verify_locations(cadata=self._read_authorities())
            except (ssl.SSLError, ValueError) as error:
                message = f"{self.authorities} has no certificates in it: {error}"
                raise UserError(message) from error
        self._load_certificate(context)

    def _read_authorities(self) -> str:
        assert self.authorities is not None, "asked before"
        return _read_text(self.authorities, "the broker's authority")

    def _load_certificate(self, context: ssl.SSLContext) -> None:
        if self.certificate is None or self.key is None:
            return
        try:
            context.load_cert_chain(self.certificate, self.key, password=lambda: "")
        except (OSError, ValueError) as error:
            raise UserError(
                f"the certificate {self.certificate} cannot be used: {error}",
                hint="it must be in PEM and fit its key, which must not be encrypted",
            ) from error


def _read_text(path: Path, what: str) -> str:
    try:
        return path.read_text("utf-8")
    except (OSError, UnicodeDecodeError) as error:
        raise UserError(f"{path} cannot be read for {what}: {error}") from error
