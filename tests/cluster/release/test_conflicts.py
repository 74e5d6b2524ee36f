"""What another release owns is refused."""

from __future__ import annotations

from typing import Any

import pytest

from rigel_k8s.objects.marks import RELEASE_LABEL
from rigel_k8s.objects.refs import ObjectRef
from rigel_k8s.release.refusals.verdict import Refused
from rigel_k8s.release.types import Desired, ReleaseId
from tests.support.releases import deploy

pytestmark = pytest.mark.cluster


def test_another_releases_object_is_refused_even_with_adopt(
    cluster: Any, make: Any, report: Any
) -> None:
    """Two releases write as one manager, so Kubernetes would see no conflict; we do."""
    deploy(make.desired(make.config(a="1")), cluster, report=report)
    other = Desired(ReleaseId(make.namespace, "other"), (make.config(a="2"),))
    with pytest.raises(Refused, match="nothing was changed") as caught:
        deploy(other, cluster, report=report, adopt=True)
    assert "belongs to another release (demo)" in caught.value.details[0]
    assert caught.value.problems[0].kind == "other-release"
    live = cluster.get(ObjectRef("v1", "ConfigMap", make.namespace, "config"))
    assert live["data"] == {"a": "1"}
    assert live["metadata"]["labels"][RELEASE_LABEL] == "demo"
