"""network install, status, remove: Multus and whereabouts on the cluster."""

from __future__ import annotations

from rigel_k8s.commands.interruption import writing
from rigel_k8s.kube import connect
from rigel_k8s.network.multus import install as network_install
from rigel_k8s.network.multus import removal as network_removal
from rigel_k8s.network.multus.install import MultusResult
from rigel_k8s.network.multus.removal import Removed
from rigel_k8s.network.multus.status import NetworkStatus, network_status
from rigel_k8s.network.options import Install
from rigel_k8s.report import Reporter
from rigel_k8s.settings import Settings


def install(settings: Settings, options: Install, report: Reporter) -> MultusResult:
    """Install or update both, and wait until every machine attaches pods."""
    cluster = connect(settings)
    with writing(cluster, settings, report) as how:
        return network_install.install(cluster, options, how)


def status(settings: Settings, options: Install) -> NetworkStatus:
    """Return the state of both on each machine, and pods without their network."""
    with connect(settings) as cluster:
        return network_status(cluster, options)


def remove(
    settings: Settings, options: Install, report: Reporter, *, force: bool, definitions: bool
) -> Removed:
    """Remove both in an order in which every machine keeps starting pods."""
    cluster = connect(settings)
    with writing(cluster, settings, report) as how:
        return network_removal.remove(cluster, options, how, force=force, definitions=definitions)
