"""`rigel trust`."""

from __future__ import annotations

from pathlib import Path

import click

from rigel_k8s.cli.words import settings


@click.command()
@click.argument("directory", required=False, type=click.Path(path_type=Path))
@click.option("--list", "show", is_flag=True, help="Print the trusted directories.")
@click.option("--remove", is_flag=True, help="Remove the directory from the trusted ones.")
@click.pass_context
def trust(
    ctx: click.Context,
    /,
    directory: Path | None,
    show: bool,  # noqa: FBT001 - click passes it by name
    remove: bool,  # noqa: FBT001 - the same
) -> None:
    """Trust a directory: DIRECTORY, or the one of the Rigelfile.

    Commands then import the job types and providers in it, and read files outside of it that its
    Rigelfile names. Trust applies to this directory, not to those below it.
    """
    from rigel_k8s.system import trust as trusting

    place = directory or settings(ctx).rigelfile.parent
    if show:
        for path in trusting.read_trusted():
            click.echo(path)
    elif remove:
        known = trusting.distrust(place)
        click.echo(f"{place.resolve()} {'is no longer trusted' if known else 'was not trusted'}")
    else:
        new = trusting.trust(place)
        click.echo(f"{place.resolve()} {'is trusted now' if new else 'was trusted already'}")
