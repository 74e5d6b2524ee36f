"""The fields that patches may have are those of Kubernetes' own description."""

from __future__ import annotations

from tools.kubefields import FILE, write

TEXT = {"type": "string"}
REF = {"$ref": "#/definitions/io.k8s.api.core.v1.PodSpec"}


def test_a_description_becomes_a_line_for_each_type() -> None:
    """Without what only the cluster writes; each type once, though two have it."""
    pod = {
        "properties": {
            "args": {"type": "array", "items": TEXT},
            "labels": {"type": "object", "additionalProperties": TEXT},
            "memory": {"$ref": "#/definitions/io.k8s.apimachinery.pkg.api.resource.Quantity"},
            "free": {"type": "object"},
            "name": TEXT,
        },
        "required": ["name"],
    }
    made = write(
        {
            "io.k8s.api.apps.v1.Deployment": {"properties": {"spec": REF, "status": TEXT}},
            "io.k8s.api.batch.v1.Job": {"properties": {"spec": REF, "n": {"type": "integer"}}},
            "io.k8s.api.core.v1.PodSpec": pod,
        },
        "v1.99",
    )
    assert made.splitlines() == [
        "# The fields of Kubernetes v1.99; python -m tools.kubefields writes them.",
        "Deployment spec:PodSpec",
        "Job n:i spec:PodSpec",
        "PodSpec args:[s] free:* labels:{s} memory:q name!:s",
    ]


def test_the_file_is_one_of_those() -> None:
    names = [line.split(" ")[0] for line in FILE.read_text("utf-8").splitlines()]
    assert names[0] == "#"
    assert {"Deployment", "Job", "PodSpec", "Container", "EnvVarSource"} <= set(names)
    assert len(FILE.read_bytes()) < 20_000
