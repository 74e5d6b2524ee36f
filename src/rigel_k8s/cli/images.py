"""`rigel image`."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, Any, Literal, TypeAlias

import click

from rigel_k8s.cli.words import Group, choose_reporter

if TYPE_CHECKING:
    from rigel_k8s.lab import BaseImage

Variant: TypeAlias = Literal["core", "devel"]
Arch: TypeAlias = Literal["amd64", "arm64"]


arch_option = click.option(
    "--arch",
    type=click.Choice(["amd64", "arm64"]),
    help="Build for machines of this architecture; another one than this machine's needs"
    " qemu-user-static and arch-test [default: this machine's].",
)
force_option = click.option("--force", is_flag=True, help="Build the image again.")


def push_option(example: str) -> Callable[[Any], Any]:
    """Return the option to push an image; its help has an example of a name."""
    text = f"Push the image under this name, for example HOST:PORT/{example}."
    return click.option("--push", metavar="IMAGE", help=text)


def build_and_deliver(
    ctx: click.Context, build: Callable[..., BaseImage], push: str | None, **options: object
) -> None:
    """Build an image unless it exists, load it into podman or docker or push it; print its name."""
    from rigel_k8s import lab

    with choose_reporter(ctx) as report:
        name = lab.deliver(build(report, **options), push, report)
    click.echo(name)


@click.group(cls=Group)
def image() -> None:
    """Images for machines that cannot pull from the internet."""


@image.command("ros1-base")
@push_option("ros:noetic")
@click.option("--variant", type=click.Choice(["core", "devel"]), default="core", show_default=True)
@arch_option
@force_option
@click.pass_context
def ros1_base(
    ctx: click.Context,
    /,
    push: str | None,
    variant: Variant,
    arch: Arch | None,
    force: bool,  # noqa: FBT001
) -> None:
    """A ROS 1 base image from Debian's packages, used like ros:noetic."""
    from rigel_k8s import lab

    build_and_deliver(ctx, lab.ros1base.build, push, variant=variant, arch=arch, force=force)


@image.command("ros-exporter")
@push_option("ros-exporter")
@arch_option
@force_option
@click.pass_context
def ros_exporter(ctx: click.Context, /, push: str | None, arch: Arch | None, force: bool) -> None:  # noqa: FBT001
    """The image of the exporter for an application's ros_metrics."""
    from rigel_k8s import lab

    build_and_deliver(ctx, lab.exporter.build, push, arch=arch, force=force)


@image.command("muto-agent")
@push_option("muto-agent")
@arch_option
@force_option
@click.pass_context
def muto_agent(ctx: click.Context, /, push: str | None, arch: Arch | None, force: bool) -> None:  # noqa: FBT001
    """The image of the agent that executes commands of Eclipse Muto."""
    from rigel_k8s import lab

    build_and_deliver(ctx, lab.mutoagent.build, push, arch=arch, force=force)
