"""`rigel rbac`."""

from __future__ import annotations

import click

from rigel_k8s.cli.words import settings, warn


@click.command()
@click.argument("purpose", type=click.Choice(["deployer", "viewer", "installer"]))
@click.option(
    "-n",
    "--namespace",
    metavar="NAME",
    help="Write the Role for this namespace [default: the context's].",
)
@click.option("--user", "users", metavar="NAME", multiple=True, help="Bind the Role to this user.")
@click.option(
    "--group", "groups", metavar="NAME", multiple=True, help="Bind the Role to this group."
)
@click.option(
    "--serviceaccount",
    "accounts",
    metavar="NAMESPACE:NAME",
    multiple=True,
    help="Bind the Role to this service account.",
)
@click.pass_context
def rbac(
    ctx: click.Context,
    /,
    purpose: str,
    namespace: str | None,
    users: tuple[str, ...],
    groups: tuple[str, ...],
    accounts: tuple[str, ...],
) -> None:
    """Print the least rights for a purpose, as YAML for `kubectl apply -f -`.

    deployer: deploys, views and deletes applications in one namespace. viewer: views what runs in
    a namespace and reads logs; no Secrets, and no commands in pods. installer: installs Multus,
    whereabouts and the observability stack, which needs about the rights of an administrator.
    """
    from rigel_k8s.commands import rbac as roles
    from rigel_k8s.yaml_text import documents

    subjects = [
        *(roles.subject("User", name) for name in users),
        *(roles.subject("Group", name) for name in groups),
        *map(roles.account, accounts),
    ]
    found = roles.roles(settings(ctx), purpose, subjects, namespace=namespace)
    click.echo(documents(found), nl=False)
    if purpose == "deployer" and (where := roles.find_open_namespace(settings(ctx), namespace)):
        warn(
            [
                f"the namespace {where} does not enforce Pod Security, so its deployers can act as"
                " root on every machine; to prevent that: kubectl label namespace"
                f" {where} pod-security.kubernetes.io/enforce=baseline"
            ]
        )
