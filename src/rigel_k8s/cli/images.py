"""`rigel image`."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Literal, TypeAlias

import click

from rigel_k8s.cli.words import Group, choose_reporter

Variant: TypeAlias = Literal["core", "devel"]
Distro: TypeAlias = Literal["jazzy", "kilted"]


force_option = click.option("--force", is_flag=True, help="Build the image again.")


def push_option(example: str) -> Callable[[Any], Any]:
    """Return the option to push an image; its help has an example of a name."""
    text = f"Push the image under this name, for example HOST:PORT/{example}."
    return click.option("--push", metavar="IMAGE", help=text)


@click.group(cls=Group)
def image() -> None:
    """Images for machines that cannot pull from the internet."""


@image.command("ros1-base")
@push_option("ros:noetic")
@click.option("--variant", type=click.Choice(["core", "devel"]), default="core", show_default=True)
@force_option
@click.pass_context
def ros1_base(ctx: click.Context, /, push: str | None, variant: Variant, force: bool) -> None:  # noqa: FBT001
    """A ROS 1 base image from Debian's packages, used like ros:noetic."""
    from rigel_k8s.commands import images

    with choose_reporter(ctx) as report:
        name = images.ros1_base(report, variant=variant, push=push, force=force)
    click.echo(name)


@image.command("ros2-base")
@push_option("ros:jazzy")
@click.option(
    "--distro", type=click.Choice(["jazzy", "kilted"]), default="jazzy", show_default=True
)
@force_option
@click.pass_context
def ros2_base(ctx: click.Context, /, push: str | None, distro: Distro, force: bool) -> None:  # noqa: FBT001
    """A ROS 2 base image from Debian and PyPI's wheels, used like ros:jazzy."""
    from rigel_k8s.commands import images

    with choose_reporter(ctx) as report:
        name = images.ros2_base(report, distro=distro, push=push, force=force)
    click.echo(name)


@image.command("ros-exporter")
@push_option("ros-exporter")
@force_option
@click.pass_context
def ros_exporter(ctx: click.Context, /, push: str | None, force: bool) -> None:  # noqa: FBT001
    """The image of the exporter for an application's ros_metrics."""
    from rigel_k8s.commands import images

    with choose_reporter(ctx) as report:
        name = images.ros_exporter(report, push=push, force=force)
    click.echo(name)


@image.command("muto-agent")
@push_option("muto-agent")
@force_option
@click.pass_context
def muto_agent(ctx: click.Context, /, push: str | None, force: bool) -> None:  # noqa: FBT001
    """The image of the agent that executes commands of Eclipse Muto."""
    from rigel_k8s.commands import images

    with choose_reporter(ctx) as report:
        name = images.muto_agent(report, push=push, force=force)
    click.echo(name)
