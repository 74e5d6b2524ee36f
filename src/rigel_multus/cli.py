"""`rigel network`: Multus and whereabouts on the cluster."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING, Any, TypeVar

import attrs
import click

from rigel_k8s.cli.width import WARNING
from rigel_k8s.cli.words import Group, Timeout, choose_reporter, json_option, print_json, settings
from rigel_k8s.errors import UserError

if TYPE_CHECKING:
    from rigel_k8s.network.options import Install
    from rigel_multus.status import NetworkStatus, PartStatus

F = TypeVar("F", bound=Callable[..., Any])

PLACES = (
    click.option(
        "--platform",
        type=click.Choice(["k3s", "microk8s", "kind", "minikube", "plain"]),
        help="Install for this distribution [default: recognized from its nodes].",
    ),
    click.option(
        "--data-dir",
        metavar="DIR",
        help="Use this data directory of k3s [default: as its nodes report].",
    ),
    click.option(
        "--cni-conf-dir",
        metavar="DIR",
        help="Use this directory of CNI configuration on the machines.",
    ),
    click.option(
        "--cni-bin-dir", metavar="DIR", help="Use this directory of CNI programs on the machines."
    ),
)
IMAGES = (
    click.option(
        "--multus-image",
        metavar="IMAGE",
        help="Use this image, for example from your own registry.",
    ),
    click.option(
        "--whereabouts-image",
        metavar="IMAGE",
        help="Use this image, for example from your own registry.",
    ),
    click.option(
        "--plugins-image",
        metavar="IMAGE",
        help="Install CNI's standard programs in /opt/cni/bin, for machines without macvlan.",
    ),
)


def with_options(*options: Callable[[F], F]) -> Callable[[F], F]:
    """Return a decorator that gives a command several options."""

    def decorate(command: F) -> F:
        for option in reversed(options):
            command = option(command)
        return command

    return decorate


@click.group(cls=Group)
def network() -> None:
    """Second networks for pods: Multus and whereabouts on the cluster.

    A Rigelfile with `network: {install: true}` runs `install` automatically.
    """


@network.command()
@with_options(*PLACES, *IMAGES)
@click.option("--timeout", type=Timeout(), help="Wait at most this long, for example 5m.")
@click.option("--adopt", is_flag=True, help="Take over existing objects of the same names.")
@click.pass_context
def install(
    ctx: click.Context,
    /,
    timeout: float | None,
    adopt: bool,  # noqa: FBT001 - click passes it by name
    **words: str | bool | None,
) -> None:
    """Install or update both, and test them on each machine. Existing installations are used."""
    from rigel_k8s.commands.interruption import writing
    from rigel_k8s.kube import connect
    from rigel_multus import install as installation

    options, own = options_of(words), settings(ctx, timeout=timeout, adopt=adopt)
    cluster = connect(own)
    with choose_reporter(ctx) as report, writing(cluster, own, report) as how:
        done = installation.install(cluster, options, how)
    click.echo(installation.describe(done))


@network.command()
@with_options(*PLACES)
@json_option
@click.pass_context
def status(ctx: click.Context, /, output: str, **words: str | None) -> int:
    """Show both on each machine, and pods without their network. Exit code 1 if any is missing."""
    from rigel_k8s.kube import connect
    from rigel_multus.status import network_status

    options = options_of(words)
    with connect(settings(ctx)) as cluster:
        found = network_status(cluster, options)
    if output == "json":
        print_json({**attrs.asdict(found), "ok": found.ok})
    else:
        show(found)
    return 0 if found.ok else 1


@network.command()
@with_options(*PLACES, *IMAGES)
@click.option(
    "--force", is_flag=True, help="Remove even if pods are attached or machines are unreachable."
)
@click.option(
    "--definitions",
    is_flag=True,
    help="Delete the custom resource definitions too, and so the attachments of all applications.",
)
@click.option("--timeout", type=Timeout(), help="Wait at most this long, for example 5m.")
@click.pass_context
def remove(
    ctx: click.Context,
    /,
    force: bool,  # noqa: FBT001 - click passes them by name
    definitions: bool,  # noqa: FBT001
    timeout: float | None,
    **words: str | None,
) -> None:
    """Remove both, in an order in which every machine keeps starting pods."""
    from rigel_k8s.commands.interruption import writing
    from rigel_k8s.kube import connect
    from rigel_multus import removal

    options, own = options_of(words), settings(ctx, timeout=timeout)
    cluster = connect(own)
    with choose_reporter(ctx) as report, writing(cluster, own, report) as how:
        done = removal.remove(cluster, options, how, force=force, definitions=definitions)
    kept = "; the kinds and all attachments are kept (see --definitions)" if done.kept else ""
    click.echo(f"removed Multus and whereabouts: {done.count} objects deleted{kept}")


def options_of(words: Mapping[str, str | bool | None]) -> Install:
    """Return the words as the options of a Rigelfile.

    Raises:
        UserError: they are not valid options.
    """
    from rigel_k8s.network.checks import check_install
    from rigel_k8s.network.options import Install
    from rigel_k8s.rigelfile import InvalidOptions, structure_plain

    options = {name: word for name, word in words.items() if word is not None}
    try:
        return structure_plain(options, Install, check_install)
    except InvalidOptions as error:
        raise UserError(
            "these options are not valid",
            details=[f"--{str(p.path[0]).replace('_', '-')}: {p.message}" for p in error.problems],
        ) from error


def show(found: NetworkStatus) -> None:
    """Print a status as text."""
    from rigel_k8s.cli.tables import table

    click.echo(f"Multus       {line_of(found.multus)}")
    click.echo(f"whereabouts  {line_of(found.whereabouts)}")
    heads = ["NODE", "PLATFORM", "MULTUS", "WHEREABOUTS", "ATTACHES", "CNI DIRECTORIES"]
    rows = [
        [
            node.name,
            node.platform,
            state(node.multus, node.up),
            state(node.whereabouts, node.up),
            "tested" if node.proven else "not tested",
            f"{node.conf_dir} {node.bin_dir}",
        ]
        for node in found.nodes
    ]
    click.echo(f"\n{table(heads, rows)}")
    for wrong in found.missing:
        click.secho(f"\n{wrong}", fg=WARNING, nl=False)
        click.echo(f"\n  kubectl -n {wrong.namespace} delete pod {wrong.pod}")


def line_of(part: PartStatus | None) -> str:
    if part is None:
        return "not installed: rigel network install"
    by = "installed by rigel" if part.ours else "installed by others, used as it is"
    return f"{part.where}, {part.image} ({by})"


def state(ready: bool, up: bool) -> str:  # noqa: FBT001 - two columns of a table
    """Return the state of a part on a machine."""
    return "ready" if ready else "not ready" if up else "unreachable"
