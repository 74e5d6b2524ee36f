"""Options and values that ended, and what replaces each: `rigel check` prints it at their place."""

from __future__ import annotations

from collections.abc import Mapping

from rigel_k8s.problems import Path

WITHOUT_DHCP = "use `whereabouts` or `static` with a range that your DHCP server does not give out"
ALLOY = "use `otel-collector`"

#: Paths from a job's options, "*" for any key; a value is the last step of its path.
ENDED: Mapping[tuple[str, ...], str] = {
    ("network", "ipvlan"): "use `macvlan`",
    ("network", "mode", "ipvlan"): "use `macvlan`",
    ("network", "ipam", "dhcp"): WITHOUT_DHCP,
    ("network", "install", "dhcp"): "remove it (nothing takes addresses from DHCP any more)",
    ("observability", "collector", "alloy"): ALLOY,
    ("observability", "alloy"): ALLOY,
    ("collector", "alloy"): ALLOY,  # a job of the stack's own
    ("alloy",): ALLOY,
}


def find_replacement(path: Path) -> str | None:
    """Return what replaces an option or value that ended; None: it is not such a one."""
    for ended, replacement in ENDED.items():
        if len(ended) == len(path) and all(
            word in ("*", step) for word, step in zip(ended, path, strict=True)
        ):
            return replacement
    return None
