"""What a node loads into its process; independent of Kubernetes objects."""

# ruff: noqa: RUF009 - option() returns an attrs field, a new one for each use
from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import attrs

from rigel_k8s.objects.fields import option, required_field
from rigel_k8s.objects.naming import ros_name
from rigel_k8s.objects.podoptions import Scalar
from rigel_k8s.objects.scalars import RosName


@attrs.frozen(kw_only=True)
class Component:
    """A composable node of ROS 2, or a nodelet of ROS 1."""

    package: str | None = option("ROS 2: the package that has the plugin")
    plugin: str = required_field(
        "the class: image_proc::RectifyNode in ROS 2, image_proc/rectify in ROS 1"
    )
    name: RosName | None = option("its ROS name, if it differs from the key")
    namespace: RosName | None = option("its ROS namespace")
    parameters: Mapping[str, Any] = option("its private parameters", {})
    remappings: Mapping[RosName, RosName] = option("ROS names: from -> to", {})
    extra_arguments: Mapping[str, Scalar] = option(
        "ROS 2: further arguments of the component, such as use_intra_process_comms", {}
    )

    def full_name(self, key: str) -> str:
        """Return the component's full ROS name, by its key."""
        return ros_name(self.name or key, self.namespace)
