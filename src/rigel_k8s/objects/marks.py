"""Labels and annotations that identify a release on a cluster and describe its workloads."""

from __future__ import annotations

from rigel_k8s.objects.refs import Manifest

#: The owner of the fields that `rigel` applies.
FIELD_MANAGER = "rigel"
#: On every object of a release: the release's name (the deployment_name), as a label value.
RELEASE_LABEL = "rigel-k8s/release"
#: The selector's label; it is the one of src.plugin; it cannot change because selectors cannot.
NAME_LABEL = "app.kubernetes.io/name"
#: On a workload: identities that only one workload of a namespace may have at a time (ROS names).
SINGLETON_ANNOTATION = "rigel-k8s/singleton"
#: On a workload, "true": the release's other workloads start when it is ready (a ROS master).
FIRST_ANNOTATION = "rigel-k8s/first"
#: On a workload, "true": the release succeeds without it, with a warning.
OPTIONAL_ANNOTATION = "rigel-k8s/optional"
#: On such a workload: what a user can do if it does not become ready.
REMEDY_ANNOTATION = "rigel-k8s/remedy"
#: On a workload whose image `image` does not set: what to do if it is not there, or not right.
IMAGE_ANNOTATION = "rigel-k8s/image"
#: On a Deployment and its pods while a node is developed in them: which one, by whom, since when.
DEVELOPMENT_ANNOTATION = "rigel-k8s/development"
#: On a pod whose place in the network a program on another computer has: whose program.
JOINED_ANNOTATION = "rigel-k8s/joined"
#: On a pod that only pulls the images of an update, instead of the release's label: its name.
PULL_LABEL = "rigel-k8s/pull"

#: kubectl's note on a pod's template that it was restarted. It is in no Rigelfile, and stays.
RESTARTED_ANNOTATION = "kubectl.kubernetes.io/restartedAt"


def image_remedy_of(manifest: Manifest) -> str:
    """Return what to do if a workload's image is not there, or not right; "" if that is plain."""
    return str((manifest["metadata"].get("annotations") or {}).get(IMAGE_ANNOTATION, ""))


def is_optional(manifest: Manifest) -> bool:
    """Whether a release is good even without a workload."""
    return (manifest["metadata"].get("annotations") or {}).get(OPTIONAL_ANNOTATION) == "true"


def find_development(live: Manifest | None) -> str:
    """Return what is developed in an object, by whom, and since when; "" for nothing."""
    notes = live["metadata"].get("annotations") if live else None
    return str((notes or {}).get(DEVELOPMENT_ANNOTATION, ""))


def remedy_of(manifest: Manifest) -> str:
    """Return what to do if an optional workload does not become ready, "" for nothing."""
    return str((manifest["metadata"].get("annotations") or {}).get(REMEDY_ANNOTATION, ""))
