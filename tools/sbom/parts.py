"""One component of something that we deliver."""

from __future__ import annotations

import attrs

#: For a licence whose text was not found, or is not a well-known one.
UNKNOWN = "unknown"


@attrs.frozen(order=True)
class Part:
    """A package of one version.

    Attributes:
        kind: the type of its package URL: `pypi`, `deb`, `golang`.
        name: as its registry has it, for Go modules with slashes.
        version: as its registry has it.
        licence: SPDX identifier or expression, Debian's names, or UNKNOWN.
        sha256: the digests of its files, if their source has them.
    """

    kind: str
    name: str
    version: str
    licence: str = UNKNOWN
    sha256: tuple[str, ...] = ()
