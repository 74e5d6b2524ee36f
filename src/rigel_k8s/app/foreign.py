"""Keys of docker compose, Kubernetes and launch files, and what a node or a job has instead."""

from __future__ import annotations

from collections.abc import Mapping

_AGAIN = "Kubernetes always starts it again; with `kind: task` it runs once"
_CONTAINER = "write it in `patch`, at the container ros-node"
_MEMORY = "write `volumes: [{memory: 1Gi, mount_path: /dev/shm}]`, or `pod` at nodes that share it"
_POD = "write it in `patch`, at spec.template.spec"
_RESOURCES = "write `resources: {limits: {cpu: 2, memory: 1Gi, nvidia.com/gpu: 1}}`"

#: At a node.
OF_NODES: Mapping[str, str] = {
    **dict.fromkeys(("restart", "restartPolicy", "respawn", "required"), _AGAIN),
    **dict.fromkeys(
        (
            "envFrom",
            "livenessProbe",
            "working_dir",
            "workingDir",
            "cwd",
            "tty",
            "stdin",
            "stdin_open",
        ),
        _CONTAINER,
    ),
    **dict.fromkeys(("ipc", "hostIPC", "shm_size"), _MEMORY),
    **dict.fromkeys(
        ("affinity", "dns", "extra_hosts", "hostAliases", "hostPID", "initContainers", "pid"), _POD
    ),
    **dict.fromkeys(("cpus", "deploy", "gpus", "mem_limit"), _RESOURCES),
    **dict.fromkeys(("node", "nodeName", "nodeSelector"), "write `placement`"),
    **dict.fromkeys(("output", "emulate_tty"), "all that it prints is in its log: remove it"),
    **dict.fromkeys(("arguments", "ros_arguments"), "write `args`"),
    **dict.fromkeys(("prefix", "launch-prefix"), "write it before the program in `args`"),
    **dict.fromkeys(("container_name", "hostname"), "its key in `nodes` is its name: remove it"),
    **dict.fromkeys(("networks", "network_mode"), "write `network` of the job, or `host_network`"),
    **dict.fromkeys(("containers", "metadata", "spec", "template"), "write it in `patch`"),
    "annotations": "write it in `patch`, at spec.template.metadata",
    "build": "a job of rigel_k8s.BuildXPlugin builds images",
    "cap_add": "write `security_context: {capabilities: {add: [SYS_NICE]}}`",
    "depends_on": "all nodes start at once, and one that gives up is started again: remove it",
    "domain_id": "write `network: {mode: peers, domain_id: 7}` at the job",
    "entrypoint": "write `command`",
    "env_file": "write its lines as `env`",
    "environment": "write `env`",
    "exec": "write `executable`",
    "healthcheck": "write `readiness`",
    "ingress": "write `service_type`",
    "ns": "write `namespace`",
    "privileged": "write `security_context: {privileged: true}`",
    "strategy": "write `update: {strategy: Recreate}`",
    "tmpfs": "write `volumes: [{memory: 64Mi, mount_path: /tmp}]`",
    "user": "write `security_context: {runAsUser: 1000}`",
}
#: At a job.
OF_JOBS: Mapping[str, str] = {
    **dict.fromkeys(("domain_id", "ros_domain_id"), "write `network: {mode: peers, domain_id: 7}`"),
    "distro": "it is `distro` of `application`",
    "rmw_implementation": "write `middleware`",
    "services": "write `nodes`",
}
