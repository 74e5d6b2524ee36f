"""Why a request has no answer: the errors of urllib3, OpenSSL and the kernel, as phrases."""

from __future__ import annotations

import http.client
import ssl

from urllib3.exceptions import ConnectTimeoutError, HTTPError, NewConnectionError, ProxyError

#: The errors of an exchange that ends without an answer.
BROKEN = (HTTPError, http.client.HTTPException, OSError)


def is_sent(error: BaseException) -> bool:
    """Whether the server may have received a request that broke: the connection existed before."""
    return not isinstance(error, (NewConnectionError, ConnectTimeoutError, ProxyError))


def is_untrusted(error: BaseException) -> bool:
    """Whether a server showed a certificate that is not trusted: it will show the same again."""
    return isinstance(cause_of(error), ssl.SSLCertVerificationError)


def reason_of(error: BaseException) -> str:
    """Return why no answer came, in the words of the innermost error."""
    cause = cause_of(error)
    if isinstance(cause, ssl.SSLCertVerificationError):
        return f"its certificate is not trusted: {cause.verify_message}"
    return getattr(cause, "strerror", None) or str(cause) or type(cause).__name__


def cause_of(error: BaseException) -> BaseException:
    """Return the innermost error: urllib3 wraps it in text about its own pools and retries."""
    inner = (getattr(error, "reason", None), *reversed(error.args), error.__cause__)
    found = next((one for one in inner if isinstance(one, BaseException)), None)
    return error if found is None else cause_of(found)
