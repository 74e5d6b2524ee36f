"""Quantities as numbers, and as a person writes them."""

from __future__ import annotations

from decimal import Decimal

import pytest

from rigel_k8s.objects.resources import format_quantity, parse_quantity


@pytest.mark.parametrize(
    ("text", "number"),
    [
        ("250m", "0.25"),
        ("6264841n", "0.006264841"),
        ("64Ki", "65536"),
        ("2", "2"),
        ("1G", "1000000000"),
        ("1e3", "1000"),
        ("0.5", "0.5"),
    ],
)
def test_quantities_are_exact_numbers(text: str, number: str) -> None:
    """As quotas, limits and the metrics-server write them."""
    assert parse_quantity(text) == Decimal(number)


def test_sums_of_tenths_are_exact() -> None:
    """Three tenths fit into 0.3, which binary fractions would deny."""
    assert parse_quantity("0.1") * 3 == parse_quantity("300m")


@pytest.mark.parametrize("text", ["250m", "3", "64Mi", "1500Mi", "2Gi", "1"])
def test_a_value_is_written_as_a_person_would(text: str) -> None:
    """Read again, it is the same."""
    assert format_quantity(parse_quantity(text)) == text
