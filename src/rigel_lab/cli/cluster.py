"""`rigel cluster`: a real Kubernetes on this machine."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import closing, contextmanager
from typing import TYPE_CHECKING

import attrs
import click

from rigel_k8s.cli.width import WARNING
from rigel_k8s.cli.words import Group, choose_reporter, json_option, print_json
from rigel_k8s.objects.text import plural

if TYPE_CHECKING:
    from rigel_lab.cli.steps import Steps
    from rigel_lab.cluster import ClusterStatus


def complete_name(
    ctx: click.Context, param: click.Parameter, incomplete: str
) -> list[str]:  # pragma: no cover - called by the shell
    """Return the existing clusters."""
    from rigel_lab import cluster as local

    return [name for name in local.names() if name.startswith(incomplete)]


name_option = click.option(
    "--name",
    default="local",
    show_default=True,
    help="Use the cluster with this name; its context is rigel-NAME.",
    shell_complete=complete_name,
)


@click.group(cls=Group)
def cluster() -> None:
    """A real Kubernetes on this machine, for development and tests.

    Every node is a set of Linux namespaces: no container engine, no virtual machine. Needs Linux
    and root; elsewhere kind, minikube or k3s serve as well.
    """


@cluster.command()
@name_option
@click.option(
    "--nodes", type=int, metavar="K", help="Give a new cluster this many nodes [default: 2]."
)
@click.option(
    "--with",
    "extras",
    multiple=True,
    type=click.Choice(["kubectl", "multus", "observability", "promtail", "prometheus-operator"]),
    metavar="[kubectl|multus|observability]",
    help="Add these images to the cluster's registry, or a kubectl of the same version;"
    " repeatable, also for a running cluster.",
)
# For the tests; src/rigel_lab/README.md describes them.
@click.option("--k3s", "data_dir", hidden=True)
@json_option
@click.pass_context
def up(
    ctx: click.Context,
    /,
    name: str,
    nodes: int | None,
    extras: tuple[str, ...],
    data_dir: str | None,
    output: str,
) -> None:
    """Start a cluster, or the parts of it that do not run.

    The first time its programs are downloaded from their projects' releases; those that cannot be
    downloaded are compiled (all of them: about 15 minutes on two cores). They are kept in a cache.
    The context rigel-NAME is added to your kubeconfig and becomes the current one.
    """
    from rigel_lab import cluster as local
    from rigel_lab.images import exporter

    with show_steps(ctx) as steps:
        # The registry serves the exporter besides the released images; it is built here.
        made = {exporter.UPSTREAM: lambda: exporter.build(steps).archive}
        found = local.up(
            name,
            nodes,
            extras=extras,
            data_dir=data_dir,
            made={"observability": made},
            report=steps.line,
        )
    if output == "json":
        print_json(attrs.asdict(found))
        return
    count = plural(len(found.nodes), "node")
    click.echo(f"Cluster {name} is up: Kubernetes {found.kubernetes}, {count}")
    click.echo(f"Your kubeconfig's current context is {found.context} now")
    show(found)


def show(found: ClusterStatus) -> None:
    """Print how to use a cluster, and which images its registry offers on request."""
    click.echo(f"  context   {found.context}")
    click.echo(f"  registry  {found.registry} (plain HTTP; nodes pull from it by the same name)")
    if found.kubectl:
        click.echo(f"  kubectl   {found.kubectl}")
    click.echo(f"  logs      {found.logs}/*/logs")
    for title, image in zip(("offers", *[""] * len(found.offers)), found.offers, strict=False):
        click.echo(f"  {title:<9} {image}")


@cluster.command()
@name_option
@click.pass_context
def down(ctx: click.Context, /, name: str) -> None:
    """Stop a cluster and delete all of it, with its volumes and images."""
    from rigel_lab import cluster as local

    with show_steps(ctx) as steps:
        there_was = local.down(name, report=steps.line)
    click.echo(f"Cluster {name} is deleted" if there_was else f"Cluster {name} does not exist")


@cluster.command()
@name_option
@json_option
def status(name: str, output: str) -> int:
    """Show a cluster: nodes, context, registry. Exit code 1 if it does not run."""
    from rigel_lab import cluster as local

    found = local.status(name)
    if output == "json":
        print_json(attrs.asdict(found))
        return 0 if found.running else 1
    state = "running" if found.running else "not running"
    click.echo(f"Cluster {name}: {state}, Kubernetes {found.kubernetes}")
    for problem in found.problems:
        click.secho(f"  {problem}", fg=WARNING)
    show(found)
    for node in found.nodes:
        click.echo(f"  {node.name:<9} {node.address} {'Ready' if node.ready else 'NotReady'}")
    return 0 if found.running else 1


@cluster.command()
@click.argument("images", nargs=-1, required=True, metavar="IMAGE...")
@name_option
@click.pass_context
def load(ctx: click.Context, /, images: tuple[str, ...], name: str) -> None:
    """Put images of podman or docker, or of tar files, onto every node."""
    from rigel_lab import cluster as local

    with show_steps(ctx) as steps:
        local.load(images, name, report=steps.line)


@cluster.command()
@name_option
def kubeconfig(name: str) -> None:
    """Print a kubeconfig with only this cluster."""
    from rigel_lab import cluster as local

    click.echo(local.kubeconfig_text(name), nl=False)


@contextmanager
def show_steps(ctx: click.Context) -> Iterator[Steps]:
    """Yield what shows each step, and how far it is."""
    from rigel_lab.cli.steps import Steps

    with choose_reporter(ctx) as reporter, closing(Steps(reporter)) as steps:
        yield steps
