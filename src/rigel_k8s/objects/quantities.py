"""Kubernetes' quantities as numbers: 250m, 0.5, 64Mi, 2G, 1e3."""

from __future__ import annotations

from decimal import Decimal

#: The factor of each suffix; longer suffixes are tried first.
SUFFIXES = {
    **{f"{letter}i": Decimal(1024) ** power for power, letter in enumerate("KMGTPE", 1)},
    **{letter: Decimal(1000) ** power for power, letter in enumerate("kMGTPE", 1)},
    "n": Decimal("1e-9"),
    "u": Decimal("1e-6"),
    "m": Decimal("1e-3"),
}


def parse_quantity(text: object) -> Decimal:
    """Return a quantity's value; exact, so that 3 times 0.1 is 0.3."""
    written = str(text)
    for suffix, factor in SUFFIXES.items():
        if written.endswith(suffix):
            return Decimal(written[: -len(suffix)]) * factor
    return Decimal(written)


def format_quantity(value: Decimal) -> str:
    """Return a value as a person writes it: 1500Mi, 250m, 3."""
    if value == value.to_integral_value():
        whole = int(value)
        for suffix in ("Gi", "Mi", "Ki"):
            if whole >= SUFFIXES[suffix] and whole % int(SUFFIXES[suffix]) == 0:
                return f"{whole // int(SUFFIXES[suffix])}{suffix}"
        return str(whole)
    return f"{(value * 1000).normalize():f}m"
