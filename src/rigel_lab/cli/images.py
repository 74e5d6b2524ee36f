"""`rigel image`."""

from __future__ import annotations

from importlib import import_module

import click

from rigel_k8s.cli.words import Group, choose_reporter


@click.group(cls=Group)
def image() -> None:
    """Images for machines that cannot pull from the internet."""


def add_command(name: str, module: str, example: str, text: str, *more: click.Parameter) -> None:
    """Add the command that builds an image, unless it exists, and delivers it.

    Args:
        module: of rigel_lab.images, with a function `build`.
        example: the image's name after a registry.
        more: options of this image's own.
    """

    @click.pass_context
    def build(ctx: click.Context, /, push: str | None, **options: str | bool | None) -> None:
        from rigel_lab.images.base.delivery import deliver

        recipe = import_module(f"rigel_lab.images.{module}")
        with choose_reporter(ctx) as report:
            delivered = deliver(recipe.build(report, **options), push, report)
        click.echo(delivered)

    options = [
        click.Option(
            ["--push"],
            metavar="IMAGE",
            help=f"Push the image under this name, for example HOST:PORT/{example}.",
        ),
        *more,
        click.Option(
            ["--arch"],
            type=click.Choice(["amd64", "arm64"]),
            help="Build for machines of this architecture; another one than this machine's needs"
            " qemu-user-static and arch-test [default: this machine's].",
        ),
        click.Option(["--force"], is_flag=True, help="Build the image again."),
    ]
    image.add_command(click.Command(name, callback=build, params=options, help=text))


add_command(
    "ros1-base",
    "ros1base",
    "ros:noetic",
    "A ROS 1 base image from Debian's packages, used like ros:noetic.",
    click.Option(
        ["--variant"], type=click.Choice(["core", "devel"]), default="core", show_default=True
    ),
)
add_command(
    "ros-exporter",
    "exporter",
    "ros-exporter",
    "The image of the exporter for an application's ros_metrics.",
)
add_command(
    "muto-agent",
    "mutoagent",
    "muto-agent",
    "The image of the agent that executes commands of Eclipse Muto.",
)
