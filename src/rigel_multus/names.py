"""The release of Multus and whereabouts, and their images."""

from __future__ import annotations

from rigel_k8s.release.types import ReleaseId

#: Multus and whereabouts are a release of their own, shared by all applications.
RELEASE = ReleaseId("kube-system", "rigel-network")

MULTUS_IMAGE = "ghcr.io/k8snetworkplumbingwg/multus-cni:v4.3.0-thick"
WHEREABOUTS_IMAGE = "ghcr.io/k8snetworkplumbingwg/whereabouts:v0.9.4"
#: The standard CNI programs, for clusters whose own set has no macvlan.
PLUGINS_IMAGE = "docker.io/rancher/hardened-cni-plugins:v1.9.1-build20260608"
