"""`rigel muto convert`."""

from __future__ import annotations

from typing import Any

import click

from rigel_k8s.cli.words import warn


@click.group()
def muto() -> None:
    """Use stacks of Eclipse Muto. The option `muto` of a job deploys them as they are."""


@muto.command()
@click.argument("stack")
@click.option(
    "--arg", "arguments", metavar="NAME=VALUE", multiple=True, help="A value of an argument."
)
@click.option("--image", metavar="IMAGE", help="The image with the programs of the stack.")
@click.option(
    "--distro", metavar="NAME", help="The ROS distribution (default: noetic, or jazzy for ROS 2)."
)
@click.option("--strict", is_flag=True, help="Refuse a stack that cannot be carried over whole.")
@click.option("--twin-url", metavar="URL", help="The Ditto that has what no file has.")
@click.option("--token", metavar="VARIABLE", help="The environment variable with its token.")
@click.option("--user", metavar="NAME", help="A user of the Ditto.")
@click.option("--password", metavar="VARIABLE", help="The environment variable with the password.")
def convert(
    stack: str,
    arguments: tuple[str, ...],
    image: str | None,
    distro: str | None,
    **options: Any,
) -> None:
    """Print a Rigelfile that deploys a stack, each of its nodes in a pod.

    STACK is a file, the id of a stack in a file of the working directory or of a thing at
    --twin-url, or the URL of a Ditto thing. Warnings on standard error, and comments in the
    Rigelfile, show what of the stack is not carried over.
    """
    from rigel_k8s.commands import muto as actions
    from rigel_k8s.muto.converting import Target
    from rigel_k8s.muto.options import Muto

    given = dict(map(split_argument, arguments))
    try:
        source = Muto(stack=stack, args=given, **options)
    except ValueError as error:
        raise click.UsageError(str(error)) from error
    made = actions.convert(source, Target(image, distro))
    warn(made.warnings)
    click.echo(made.text, nl=False)


def split_argument(text: str) -> tuple[str, str]:
    """Return name and value of `NAME=VALUE`."""
    name, sign, value = text.partition("=")
    if not name or not sign:
        raise click.BadParameter(f'"{text}" is not NAME=VALUE', param_hint="--arg")
    return name, value
