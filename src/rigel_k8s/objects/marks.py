"""Labels and annotations that identify a release on a cluster and describe its workloads."""

from __future__ import annotations

FIELD_MANAGER = "rigel"
#: On every object of a release: the release's name (the deployment_name), as a label value.
RELEASE_LABEL = "rigel-k8s/release"
#: On a workload: an identity that only one workload of a namespace may have at a time (a ROS name).
SINGLETON_ANNOTATION = "rigel-k8s/singleton"
#: On a workload, "true": the release's other workloads start when it is ready (a ROS master).
FIRST_ANNOTATION = "rigel-k8s/first"
#: On a workload, "true": the release succeeds without it, with a warning.
OPTIONAL_ANNOTATION = "rigel-k8s/optional"
#: On such a workload: what a user can do if it does not become ready.
REMEDY_ANNOTATION = "rigel-k8s/remedy"
