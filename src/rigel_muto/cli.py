"""`rigel muto convert` and `rigel muto agent`."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click

from rigel_k8s.cli.words import (
    Group,
    choose_reporter,
    namespace_option,
    settings,
    split_pair,
    warn,
)


def login_options(command: Any) -> Any:
    """Add the options with which a command logs in to a Ditto."""
    secret = "Read Ditto's {} from this environment variable."
    for option in (
        click.option("--password", metavar="VARIABLE", help=secret.format("password")),
        click.option("--user", metavar="NAME", help="Log in to Ditto as this user."),
        click.option("--token", metavar="VARIABLE", help=secret.format("token")),
    ):
        command = option(command)
    return command


@click.group(cls=Group)
def muto() -> None:
    """Use stacks of Eclipse Muto, and take its commands.

    The option `muto` of a job deploys a stack as it is.
    """


@muto.command()
@click.argument("stack")
@click.option(
    "--arg", "arguments", metavar="NAME=VALUE", multiple=True, help="Set an argument of the stack."
)
@click.option(
    "--reference",
    "references",
    metavar="ID=FILE",
    multiple=True,
    help="Take the stack with this id from this file, where several files have one.",
)
@click.option(
    "--image", metavar="IMAGE", help="Write this image, which contains the programs of the stack."
)
@click.option(
    "--distro",
    metavar="NAME",
    help="Write this ROS distribution [default: the current one of ROS 2, or noetic for a stack"
    " that needs ROS 1].",
)
@click.option(
    "--to",
    "directory",
    metavar="DIRECTORY",
    type=click.Path(path_type=Path),
    help="Write a new directory with the Rigelfile, and the sources of an archive.",
)
@click.option("--strict", is_flag=True, help="Refuse a stack that cannot be carried over whole.")
@click.option("--twin-url", metavar="URL", help="Ask this Ditto for stacks that no file has.")
@login_options
def convert(
    stack: str,
    arguments: tuple[str, ...],
    references: tuple[str, ...],
    image: str | None,
    distro: str | None,
    directory: Path | None,
    **options: Any,
) -> None:
    """Print a Rigelfile that deploys a stack, each of its nodes in a pod.

    STACK is a file, or the id of a stack in a file of the working directory or of a thing at
    --twin-url. Warnings on standard error, and comments in the Rigelfile, show what of the stack is
    not carried over.

    An archive with sources needs --to: the Rigelfile there builds an image of them and deploys it.
    """
    from rigel_muto import convert as actions
    from rigel_muto.options import Muto

    given = dict(split_pair(text, "NAME=VALUE", param_hint="--arg") for text in arguments)
    chosen = dict(split_pair(text, "ID=FILE", param_hint="--reference") for text in references)
    try:
        source = Muto(stack=stack, args=given, references=chosen, **options)
    except ValueError as error:
        raise click.UsageError(str(error)) from error
    if directory:
        made = actions.write(source, directory, image, distro)
    else:
        made = actions.convert(source, image, distro)
    warn(made.warnings)
    if directory is None:
        click.echo(made.text, nl=False)
    else:
        click.echo(f"{directory / 'Rigelfile'} written")


@muto.command()
@click.option(
    "--thing",
    metavar="ID",
    required=True,
    help="Listen to commands for the device with this id, NAMESPACE:NAME.",
)
@click.option(
    "--broker",
    metavar="URL",
    required=True,
    help="Connect to this broker, mqtt://HOST:PORT or mqtts://HOST:PORT.",
)
@click.option("--job", metavar="NAME", help="Deploy stacks with this job [default: the only one].")
@click.option(
    "--credentials",
    type=click.Path(path_type=Path, file_okay=False),
    help="Read the broker's username, password, ca.crt, tls.crt and tls.key from this directory;"
    " all are optional.",
)
@click.option(
    "--prefix",
    default="muto",
    show_default=True,
    help="Begin the topics of Muto's ROS 2 generation with this word.",
)
@click.option(
    "--target",
    metavar="NAME",
    help="Answer to this name of the device in Symphony [default: the thing's NAME].",
)
@click.option(
    "--twin-url", metavar="URL", help="Read stacks from this Ditto, and write to it what runs."
)
@login_options
@click.option(
    "--allow-stack",
    "stacks",
    metavar="PATTERN",
    multiple=True,
    help="Allow stacks whose id matches [default: all].",
)
@click.option(
    "--allow-image",
    "images",
    metavar="PATTERN",
    multiple=True,
    help="Allow images that match [default: all of the job].",
)
@click.option("--whole-stacks", is_flag=True, help="Allow commands that contain a whole stack.")
@click.option("--health", metavar="PORT", type=int, help="Answer probes on this port.")
@namespace_option
@click.pass_context
def agent(
    ctx: click.Context,
    /,
    token: str | None,
    user: str | None,
    password: str | None,
    stacks: tuple[str, ...],
    images: tuple[str, ...],
    whole_stacks: bool,  # noqa: FBT001 - click passes them by name
    **options: Any,
) -> None:
    """Accept commands of Muto's dashboard, of Ditto and of Symphony by MQTT, until Ctrl-C.

    They deploy a job of the Rigelfile with the stack that they name. Everyone who may publish on
    the device's topics can start programs of the job's images. The job type muto-agent runs this in
    a cluster.
    """
    from rigel_muto.agent.allowance import Allowance
    from rigel_muto.ditto import Access
    from rigel_muto.execution.serving import Agent, run

    allowance = Allowance(stacks or ("*",), images or ("*",), whole_stacks)
    access = Access(token, user, password)
    with choose_reporter(ctx) as report:
        run(Agent(access=access, allowance=allowance, **options), settings(ctx), report)
