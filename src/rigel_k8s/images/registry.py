"""Asks image registries over HTTP: are credentials valid, a tag's digest and architectures.

The protocol is the OCI distribution specification, with Docker's token authentication.
"""

from __future__ import annotations

import base64
import hashlib
import json
import os
import re
import warnings
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from contextlib import suppress
from typing import TYPE_CHECKING, Any, ClassVar
from urllib.parse import urlencode, urlsplit

import attrs

from rigel_k8s.errors import RigelK8sError, UserError
from rigel_k8s.image_reference import DOCKER_HUB, parse_reference
from rigel_k8s.images.credentials import (
    RegistryCredentials,
    credentials_for,
    is_loopback,
    is_private,
)
from rigel_k8s.system.threads import parallel
from rigel_k8s.system.tls import environment_proxy

if TYPE_CHECKING:
    import urllib3

#: In a sequence's shared data: {image reference as users write it: digest}, of all that was pushed.
DIGESTS = "image_digests"

_TIMEOUT = 3.0  # seconds for each answer of a registry
_HUB_HOST = "registry-1.docker.io"
_ACCEPT = ", ".join(
    [
        "application/vnd.oci.image.index.v1+json",
        "application/vnd.docker.distribution.manifest.list.v2+json",
        "application/vnd.oci.image.manifest.v1+json",
        "application/vnd.docker.distribution.manifest.v2+json",
    ]
)
_PARAMETER = re.compile(r'(\w+)=(?:"((?:[^"\\]|\\.)*)"|([^\s,"]+))')


class _Unclear(Exception):
    """The registry gave no usable answer; the text is the reason."""


class _NotFound(_Unclear):
    """The registry does not have the image."""


class _Unreachable(_Unclear):
    """The registry did not answer at all."""


@attrs.define
class _Patience:
    """Which registries are worth another request.

    A Rigelfile may have thousands of images at registries that do not answer, and each request
    waits for seconds. A registry that has answered once is asked until the end.
    """

    PER_REGISTRY: ClassVar[int] = 3
    IN_ALL: ClassVar[int] = 24
    _answered: set[str] = attrs.field(init=False, factory=set)
    _unanswered: Counter[str] = attrs.field(init=False, factory=Counter)

    def has_run_out(self, registry: str) -> bool:
        """Return whether too many requests had no answer, from this registry or from all."""
        if registry in self._answered:
            return False
        unanswered = self._unanswered
        return unanswered[registry] >= self.PER_REGISTRY or unanswered.total() >= self.IN_ALL

    def note(self, registry: str, *, answered: bool) -> None:
        """Remember how a request ended."""
        if answered:
            self._answered.add(registry)
        else:
            self._unanswered[registry] += 1


@attrs.frozen
class Answers:
    """What registries answer about images.

    Attributes:
        digests: by image, of those that have one.
        unknown: images whose registry says that it does not have them.
    """

    digests: Mapping[str, str]
    unknown: frozenset[str]


def look_up(
    images: Iterable[str],
    credentials: Sequence[RegistryCredentials] = (),
    *,
    timeout: float = _TIMEOUT,
) -> Answers:
    """Ask the registries of images for their digests, in parallel.

    A registry that does not answer at all is not asked for each of its images.

    Args:
        images: valid references.
        credentials: of the registries that need some.
        timeout: seconds for each answer of a registry.
    """
    asked = list(images)
    patience = _Patience()
    unknown: set[str] = set()

    def ask(image: str) -> str | None:
        reference = parse_reference(image)
        if patience.has_run_out(reference.registry):
            return None
        user = credentials_for(reference.registry, credentials)
        registry = _Registry(user or RegistryCredentials(reference.registry), timeout)
        digest = None
        try:
            digest = reference.digest or registry.digest(reference.repository, reference.version)
        except _Unreachable:
            patience.note(reference.registry, answered=False)
            return None
        except _NotFound:
            unknown.add(image)
        except _Unclear:
            pass
        patience.note(reference.registry, answered=True)
        return digest

    answers = zip(asked, parallel(ask, asked), strict=True)
    return Answers({image: digest for image, digest in answers if digest}, frozenset(unknown))


def find_architectures(
    image: str, credentials: RegistryCredentials | None = None
) -> frozenset[str]:
    """Return the kinds of Linux machines that an image runs on; empty: unknown.

    They are named as Kubernetes names them: amd64, arm64.

    Args:
        image: a reference.
        credentials: for the image's registry.
    """
    try:
        reference = parse_reference(image)
        registry = _Registry(credentials or RegistryCredentials(reference.registry), _TIMEOUT)
        return registry.architectures(reference.repository, reference.digest or reference.version)
    except (UserError, _Unclear):
        return frozenset()


def log_in(credentials: RegistryCredentials, *, timeout: float = 10.0) -> bool:
    """Try the credentials; False if the registry needs none at all.

    Raises:
        RigelK8sError: the registry refuses them, or cannot be reached.
    """
    registry = _Registry(credentials, timeout)
    try:
        return registry.log_in()
    except _Unclear as error:
        raise RigelK8sError(
            f"registry {credentials.server}: {error}",
            hint="check the server's name and the network; one without TLS needs `insecure: true`",
        ) from error


def challenge(header: str) -> tuple[str, dict[str, str]]:
    """Return scheme (in small letters) and parameters of a WWW-Authenticate header."""
    scheme, _, rest = header.strip().partition(" ")
    pairs = _PARAMETER.findall(rest)
    return scheme.lower(), {k.lower(): re.sub(r"\\(.)", r"\1", q) or bare for k, q, bare in pairs}


@attrs.define
class _Registry:
    """One registry, as one user."""

    credentials: RegistryCredentials
    timeout: float
    _authorization: str = attrs.field(init=False, default="")

    def log_in(self) -> bool:
        """Return whether the registry needs credentials; RigelK8sError if it refuses them."""
        base, answer = self._ask_bases("/v2/")
        if answer.status == 200:
            return False
        if answer.status != 401:
            raise _Unclear(f"it answered {answer.status}; a registry answers 200 or 401")
        self._authorize(base, answer.headers.get("WWW-Authenticate", ""), scope=None)
        answer = self._ask("GET", f"{base}/v2/")
        if answer.status in (401, 403):
            raise self._login_error()
        if answer.status != 200:
            raise _Unclear(f"it answered {answer.status} after the log-in")
        return True

    def digest(self, repository: str, version: str) -> str | None:
        """Return the digest of a tag, None if the repository or tag is not visible.

        Raises _NotFound if the registry says that it has no such tag or repository.
        """
        path = f"/v2/{repository}/manifests/{version}"
        base, answer = self._open(path, repository)
        if answer.status == 404 and self._knows_nothing_of(base + path):
            raise _NotFound(f"it has no {repository}:{version}")
        if answer.status != 200:
            return None
        found = answer.headers.get("Docker-Content-Digest")
        return found or self._compute_digest(base + path)

    def architectures(self, repository: str, version: str) -> frozenset[str]:
        """Return the architectures of an index, or of an image's configuration."""
        path = f"/v2/{repository}/manifests/{version}"
        base, answer = self._open(path, repository)
        if answer.status != 200:
            return frozenset()
        manifest = self._read_json(base + path)
        if "manifests" in manifest:
            platforms = [one.get("platform") or {} for one in manifest["manifests"]]
        else:
            config = (manifest.get("config") or {}).get("digest", "")
            platforms = [self._read_json(f"{base}/v2/{repository}/blobs/{config}")]
        found = {
            str(one.get("architecture") or "") for one in platforms if one.get("os") == "linux"
        }
        return frozenset(found - {"", "unknown"})

    def _read_json(self, url: str) -> dict[str, Any]:
        answer = self._ask("GET", url)
        try:
            content = json.loads(answer.data) if answer.status == 200 else {}
        except ValueError:
            content = {}
        return content if isinstance(content, dict) else {}

    def _open(self, path: str, repository: str) -> tuple[str, urllib3.BaseHTTPResponse]:
        """Request a manifest's headers, with a log-in if needed; also return the base."""
        base, answer = self._ask_bases(path)
        if answer.status == 401:
            scope = f"repository:{repository}:pull"
            with suppress(RigelK8sError):
                self._authorize(base, answer.headers.get("WWW-Authenticate", ""), scope=scope)
                answer = self._ask("HEAD", base + path)
        return base, answer

    def _knows_nothing_of(self, url: str) -> bool:
        """Whether a registry, and not just any program on the way, says that there is nothing."""
        with suppress(ValueError):
            answer = json.loads(self._ask("GET", url).data)
            errors = answer.get("errors") if isinstance(answer, dict) else None
            codes = {one.get("code") for one in errors or () if isinstance(one, dict)}
            return bool(codes & {"MANIFEST_UNKNOWN", "NAME_UNKNOWN"})
        return False

    def _compute_digest(self, url: str) -> str | None:
        answer = self._ask("GET", url)
        if answer.status != 200:
            return None
        return f"sha256:{hashlib.sha256(answer.data).hexdigest()}"

    def _ask_bases(self, path: str) -> tuple[str, urllib3.BaseHTTPResponse]:
        """Ask over HTTPS, or HTTP if allowed; also return the base that answered."""
        bases, method = self._bases(), "GET" if path == "/v2/" else "HEAD"
        for base in bases[:-1]:
            try:
                return base, self._ask(method, base + path)
            except _Unclear:
                continue
        return bases[-1], self._ask(method, bases[-1] + path)

    def _bases(self) -> list[str]:
        """Return the URLs to try; behind a proxy only a request shows which one works."""
        name, insecure = self.credentials.registry, self.credentials.insecure
        host = _HUB_HOST if name == DOCKER_HUB else name
        both = [f"https://{host}", f"http://{host}"]
        if not (insecure or is_loopback(name) or is_private(name)):
            return both[:1]
        if any(map(_proxy_of, both)):
            return both
        return both[:1] if _encrypts(host, self.timeout) else both[1:]

    def _authorize(self, base: str, header: str, *, scope: str | None) -> None:
        user = self.credentials
        if base.startswith("http://") and not (user.insecure or is_loopback(user.registry)):
            raise _Unclear("it is not encrypted: set `insecure: true` to send it the password")
        scheme, parameters = challenge(header)
        if scheme == "basic":
            self._authorization = self._basic()
        elif scheme == "bearer":
            self._authorization = f"Bearer {self._token(base, parameters, scope)}"
        else:
            raise _Unclear(f'it needs "{scheme}" authentication, which is not supported')

    def _basic(self) -> str:
        user = self.credentials
        return "Basic " + base64.b64encode(f"{user.username}:{user.password}".encode()).decode()

    def _token(self, base: str, parameters: Mapping[str, str], scope: str | None) -> str:
        realm = parameters.get("realm", "")
        if not realm.startswith(("https://", base.split("//")[0] + "//")):
            raise _Unclear(f'it sends the password to "{realm}", which is not encrypted')
        query = {"service": parameters.get("service", ""), "scope": scope or ""}
        query = {key: value for key, value in query.items() if value}
        headers = {"Authorization": self._basic()} if self.credentials.username else {}
        url = f"{realm}{'&' if '?' in realm else '?'}{urlencode(query)}"
        answer = self._send("GET", url, headers)
        if answer.status in (400, 401, 403):
            raise self._login_error()
        return _token_of(answer)

    def _login_error(self) -> RigelK8sError:
        return RigelK8sError(
            f'registry {self.credentials.server} refuses user "{self.credentials.username}"',
            hint="check username and password (or token); vars fall back to the environment",
        )

    def _ask(self, method: str, url: str) -> urllib3.BaseHTTPResponse:
        headers = {"Accept": _ACCEPT}
        if self._authorization:
            headers["Authorization"] = self._authorization
        return self._send(method, url, headers)

    def _send(self, method: str, url: str, headers: Mapping[str, str]) -> urllib3.BaseHTTPResponse:
        import urllib3

        try:
            with warnings.catch_warnings():
                # The user allowed an unverified certificate with `insecure`.
                warnings.simplefilter("ignore", urllib3.exceptions.InsecureRequestWarning)
                return _pool(url, self.timeout, verify=not self.credentials.insecure).request(
                    method, url, headers=dict(headers)
                )
        except urllib3.exceptions.HTTPError as error:
            raise _Unreachable(_reason(error)) from error


def _encrypts(host: str, timeout: float) -> bool:
    """Return whether a registry speaks TLS; its certificate is not checked here.

    That takes a millisecond; a request that is bound to fail takes twenty, because it first reads
    all certificates of the machine.

    Raises:
        _Unreachable: no program listens there.
    """
    import socket
    import ssl

    context = ssl.SSLContext(ssl.PROTOCOL_TLS_CLIENT)
    context.check_hostname, context.verify_mode = False, ssl.CERT_NONE
    url = urlsplit(f"https://{host}")
    try:
        with socket.create_connection((url.hostname, url.port or 443), timeout) as plain:
            try:
                context.wrap_socket(plain, server_hostname=url.hostname).close()
            except OSError:
                return False
            return True
    except OSError as error:
        if url.port is None:
            return False  # HTTP has another port
        raise _Unreachable(error.strerror or str(error)) from error


def _proxy_of(url: str) -> str | None:
    """Return the environment's proxy for a URL, None without one."""
    parts = urlsplit(url)
    return None if is_loopback(parts.netloc) else environment_proxy(parts, os.environ) or None


def _pool(url: str, timeout: float, *, verify: bool) -> urllib3.PoolManager:
    """Return connections that go through the environment's proxy, if it has one for the URL."""
    import urllib3

    options: dict[str, Any] = {
        "timeout": timeout,
        "retries": urllib3.Retry(connect=0, read=0, other=0, redirect=3),
        "cert_reqs": "CERT_REQUIRED" if verify else "CERT_NONE",
    }
    proxy = _proxy_of(url)
    return urllib3.ProxyManager(proxy, **options) if proxy else urllib3.PoolManager(**options)


def _token_of(answer: urllib3.BaseHTTPResponse) -> str:
    try:
        content = json.loads(answer.data)
        token = content.get("token") or content.get("access_token")
    except (ValueError, AttributeError):
        token = None
    if answer.status != 200 or not isinstance(token, str):
        raise _Unclear(f"its token server answered {answer.status} without a token")
    return token


def _reason(error: Exception) -> str:
    """The innermost cause: urllib3 wraps it in words about its own pools and retries."""
    cause: object = getattr(error, "reason", None) or error
    text = str(cause)
    return text.split(": ", 1)[-1] if text.startswith("<") or "object at 0x" in text else text
