"""`rigel completion` and `rigel version`."""

from __future__ import annotations

import click

from rigel_k8s import __version__


@click.command()
@click.argument("shell", type=click.Choice(["bash", "zsh", "fish"]))
@click.pass_context
def completion(ctx: click.Context, shell: str) -> None:
    """Print the completion script of a shell.

    For bash: rigel completion bash > /etc/bash_completion.d/rigel
    """
    from click.shell_completion import get_completion_class

    program = ctx.find_root().info_name or "rigel"
    kind = get_completion_class(shell)
    assert kind is not None
    variable = f"_{program.replace('-', '_').upper()}_COMPLETE"
    click.echo(kind(ctx.find_root().command, {}, program, variable).source())


@click.command()
def version() -> None:
    """Print the version."""
    click.echo(f"rigel-k8s {__version__}")
