"""`rigel import launch` and `rigel import compose`."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING

import click

from rigel_k8s.cli.words import Group, settings, split_pair
from rigel_k8s.errors import UserError

if TYPE_CHECKING:
    from rigel_import.draft import Draft


@click.group("import", cls=Group)
def import_() -> None:
    """Write a Rigelfile from what describes a robot already."""


FORCE = click.option("--force", is_flag=True, help="Overwrite an existing Rigelfile.")
PRINT = click.option("--print", "prints", is_flag=True, help="Print it instead of writing a file.")


@import_.command()
@click.argument("file", type=click.Path(path_type=Path, dir_okay=False))
@FORCE
@PRINT
@click.pass_context
def compose(ctx: click.Context, /, file: Path, **output: bool) -> None:
    """Write a Rigelfile from a Docker Compose FILE, each service in a pod.

    Comments in it, and lines here, say what is not carried over.
    """
    from rigel_import.compose.reading import read

    finish(ctx, lambda: read(file, settings(ctx).rigelfile.parent), **output)


@import_.command()
@click.argument("words", metavar="FILE | PACKAGE FILE", nargs=-1, required=True)
@click.option("--image", help="Run all nodes in this image, which also evaluates files in Python.")
@click.option("--distro", metavar="NAME", help="Set the ROS distribution, such as jazzy.")
@click.option("--arg", "args", metavar="NAME=VALUE", multiple=True, help="Set an argument.")
@click.option(
    "--package",
    "directories",
    metavar="NAME=DIRECTORY",
    multiple=True,
    help="Read this package there.  [default: search the workspace]",
)
@FORCE
@PRINT
@click.pass_context
def launch(
    ctx: click.Context,
    /,
    words: tuple[str, ...],
    image: str | None,
    distro: str | None,
    args: tuple[str, ...],
    directories: tuple[str, ...],
    **output: bool,
) -> None:
    """Write a Rigelfile from a launch FILE, each node in a pod.

    Comments in it, and lines here, say what is not carried over.
    """
    from rigel_import.launch.packages import find_launch_file
    from rigel_import.launch.reading import read, read_python

    if len(words) > 2:
        raise click.UsageError(f'unexpected "{words[2]}"; pass arguments with --arg NAME=VALUE')
    form = "NAME=VALUE"
    arguments = dict(split_pair(text, form, param_hint="--arg") for text in args)
    found = (split_pair(text, form, param_hint="--package") for text in directories)
    packages = {name: Path(path) for name, path in found}

    def make() -> Draft:
        if words[-1].endswith(".py"):
            return read_python(words, arguments, packages, image, distro)
        file = find_launch_file(*words, packages) if len(words) == 2 else Path(words[0])
        return read(file, arguments, packages, image, distro)

    finish(ctx, make, **output)


def finish(ctx: click.Context, read: Callable[[], Draft], *, force: bool, prints: bool) -> None:
    """Write what was read, or print it, and say what was done."""
    from rigel_import.draft import summarize, write_rigelfile

    target = settings(ctx).rigelfile
    hint = "overwrite it with --force, print with --print, or choose another with `rigel -f FILE`"
    if target.exists() and not (force or prints):
        raise UserError(f"{target} already exists", hint=hint)
    draft = read()
    files = {target.parent / path: text for path, text in draft.files.items()}
    for file in files:
        if file.exists() and not (force or prints):
            raise UserError(f"{file} already exists", hint=hint)
    text = write_rigelfile(draft, f"rigel import {ctx.info_name}")
    if prints:
        click.echo(text, nl=False)
        for file in files:
            click.echo(f"not written with --print: {file}", err=True)
        return
    for file, content in files.items():
        file.parent.mkdir(parents=True, exist_ok=True)
        file.write_text(content)
    target.write_text(text)
    for line in summarize(draft, str(target)):
        click.echo(line)
