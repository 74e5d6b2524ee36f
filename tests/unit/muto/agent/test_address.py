"""Addresses of brokers and ways to log in: what is wrong is an error before anything connects."""

from __future__ import annotations

from pathlib import Path

import pytest

from rigel_k8s.errors import UserError
from rigel_muto.agent.address import Address, Login, read_address


@pytest.mark.parametrize(
    ("text", "address"),
    [
        ("mqtt://broker", Address("broker", 1883, tls=False)),
        ("mqtts://broker.example/", Address("broker.example", 8883, tls=True)),
        ("mqtts://[::1]:1234", Address("::1", 1234, tls=True)),
    ],
)
def test_an_address_is_a_url(text: str, address: Address) -> None:
    assert read_address(text) == address
    assert read_address(str(address)) == address


@pytest.mark.parametrize(
    "text",
    [
        "",
        "broker",
        "broker:1883",
        "http://broker",
        "mqtt://",
        "mqtt://broker:0",
        "mqtt://broker:99999",
        "mqtt://broker:x",
        "mqtt://[::1",
        "mqtt://broker/topic",
        "mqtt://broker?a=b",
        f"mqtt://{'a' * 64}.example",
    ],
)
def test_what_is_no_address_is_refused(text: str) -> None:
    with pytest.raises(UserError, match="is not the address of a broker"):
        read_address(text)


def test_a_password_does_not_stand_in_the_address() -> None:
    """It would be in logs and errors."""
    with pytest.raises(UserError) as error:
        read_address("mqtt://me:s3cret@broker")
    assert "s3cret" not in str(error.value)


def test_a_password_comes_from_a_file(tmp_path: Path) -> None:
    file = tmp_path / "password"
    file.write_text("s3cret \n")
    assert Login(user="me", password_file=file).read_password() == "s3cret "
    assert Login(user="me").read_password() is None


@pytest.mark.parametrize(
    ("options", "error"),
    [
        ({"password_file": Path("p")}, "no user"),
        ({"certificate": Path("c")}, "belong together"),
        ({"key": Path("k")}, "belong together"),
    ],
)
def test_options_that_contradict_each_other_are_refused(
    options: dict[str, Path], error: str
) -> None:
    with pytest.raises(UserError, match=error):
        Login(**options)  # type: ignore[arg-type]


def test_what_cannot_be_read_is_named(tmp_path: Path) -> None:
    missing, empty = tmp_path / "missing", tmp_path / "empty"
    empty.write_text("")
    with pytest.raises(UserError, match="missing cannot be read"):
        Login(user="me", password_file=missing).read_password()
    with pytest.raises(UserError, match="missing cannot be read"):
        Login(authorities=missing).make_context()
    with pytest.raises(UserError, match="empty has no certificates"):
        Login(authorities=empty).make_context()
    with pytest.raises(UserError, match="empty cannot be used"):
        Login(certificate=empty, key=empty).make_context()
