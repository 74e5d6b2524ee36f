"""A container of a program that watches: of the stack, or an application's exporter."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from rigel_k8s.objects.pods import Object
from rigel_k8s.observability.options import Program

#: On pods: a hash of the configuration that they were started with.
CONFIG_ANNOTATION = "rigel-k8s/configuration"
#: At a start, a log of hours may be replayed; a probe that gives up would restart that.
FOR_EVER = 2**31 - 1


def container(name: str, options: Program, made: Mapping[str, Any]) -> Object:
    """Return a container that writes only to its volumes and cannot become another user.

    Args:
        made: its other fields; the options replace its image, and merge its resources. `probes`
            has the path and port of an HTTP probe: a frequent one until the start, a rare one
            afterwards.
    """
    fields = dict(made)
    image, resources = fields.pop("image"), fields.pop("resources")
    if probes := fields.pop("probes", None):
        get = {"httpGet": probes, "timeoutSeconds": 5}
        fields["startupProbe"] = {**get, "periodSeconds": 2, "failureThreshold": FOR_EVER}
        fields["readinessProbe"] = {**get, "periodSeconds": 10}
    own = {"requests": options.resources.requests, "limits": options.resources.limits}
    return {
        "name": name,
        "image": str(options.image or image),
        "imagePullPolicy": "IfNotPresent",
        **fields,
        "resources": {
            kind: {**resources[kind], **{str(k): str(v) for k, v in given.items()}}
            for kind, given in own.items()
        },
        "securityContext": {
            "allowPrivilegeEscalation": False,
            "readOnlyRootFilesystem": True,
            "capabilities": {"drop": ["ALL"]},
        },
        "terminationMessagePolicy": "FallbackToLogsOnError",
    }
