"""Every kind of problem in a Rigelfile and every exit code, with its cause and its remedy.

A message names a value and a place; its kind, in brackets behind it, is the same for all messages
of one sort, so that scripts and docs/errors.md can refer to it. docs/errors.md is generated from
these tables, and a test fails where the code has a kind that no table explains. Kinds that belong
to one feature are explained beside it: `kinds.py` in network/preflight, graph, rosgraph,
release/rollout and muto/agent. Nothing here decides what is a problem.
"""

from __future__ import annotations

from collections.abc import Mapping

import attrs


@attrs.frozen
class Kind:
    """What one kind of problem means.

    Attributes:
        cause: what is wrong: a clause in lower case, in Markdown.
        remedy: what the user can do about it, in the imperative; "" where nothing is to be done.
    """

    cause: str
    remedy: str


#: What the exit codes of `rigel` mean. A command that runs another one (`exec`) passes its code on.
EXIT_CODES: Mapping[int, Kind] = {
    0: Kind("everything that was requested is done", ""),
    1: Kind(
        "something failed on the cluster or in another program, or something is not ready",
        "read the cause and the hint below it; the same command continues where this one ended",
    ),
    2: Kind(
        "the Rigelfile, an argument or a setting is wrong",
        "change what the message names, then run the command again",
    ),
    130: Kind(
        "the command was interrupted by Ctrl-C (SIGINT)",
        "run it again; it prints what state it left",
    ),
    143: Kind("the command was ended by SIGTERM", "the same"),
}

#: The Rigelfile as a text, its templates and its structure.
FILE: Mapping[str, Kind] = {
    "yaml": Kind(
        "the text is not YAML, or uses something of YAML that a Rigelfile does not have",
        "correct the line; often a quote, a colon or the indentation is missing",
    ),
    "duplicate-key": Kind("a key is given twice in one mapping", "remove one of the two"),
    "unknown-key": Kind(
        "an option of this name does not exist here",
        "correct the name: the message has the nearest one, and [`rigel schema`](reference.md) all",
    ),
    "missing-key": Kind("a required option is missing", "add it; the message has its type"),
    "no-value": Kind("a key has nothing behind its colon", "write a value, or remove the key"),
    "wrong-type": Kind(
        "a value has another type than the option, such as text instead of a number",
        "write the type that the message names; quotes make text of anything",
    ),
    "yaml-boolean": Kind(
        "`yes`, `no`, `on` or `off` without quotes is a boolean in YAML, and text is expected",
        "put it in quotes",
    ),
    "bad-choice": Kind("a value is not one of those allowed", "choose one that the message lists"),
    "bad-value": Kind(
        "a value has the right type and is not allowed", "use a value as the message describes"
    ),
    "empty": Kind(
        "a sequence, stage or matrix is empty, so nothing would run", "fill it, or remove it"
    ),
    "template": Kind(
        "a template `{{ ... }}` is malformed, stands where none may be, or cannot be computed",
        "correct it; a [template](rigelfile.md) is an expression of jinja2 with `vars`, `data` or"
        " a key of a matrix",
    ),
    "unknown-variable": Kind(
        "a template uses a variable that is neither in `vars` nor in the environment",
        "define it in `vars`, or set the environment variable",
    ),
    "unknown-data": Kind(
        "a template uses `data.NAME`, and no job before this one stores it",
        "run the job that stores it earlier in the sequence",
    ),
    "variable-cycle": Kind("variables need each other in a circle", "give one a plain value"),
    "too-large": Kind(
        "the file, a stack, or what templates and aliases make of it exceeds a limit",
        "make it smaller, or split it; the message has the"
        " [limit](security.md#a-rigelfile-of-unknown-origin)",
    ),
    "unknown-job": Kind(
        "a sequence or Muto's agent names a job that does not exist or that it cannot use",
        "correct the name",
    ),
    "unknown-plugin": Kind(
        "`plugin` names a job type that is not installed, or cannot be imported",
        "correct the name, or install its package",
    ),
    "unknown-provider": Kind(
        "`provider` names a type that is not installed, or cannot be imported",
        "correct the name, or install its package",
    ),
    "untrusted": Kind(
        "the Rigelfile needs code or files that only a trusted directory may use",
        "read them, then run `rigel trust`",
    ),
    "bad-matrix": Kind(
        "a matrix has too many combinations, a key without a list, or a limit that is not one"
        " number above 0",
        "correct what the message names",
    ),
    "side-by-side": Kind(
        "branches that run at the same time would deploy one release",
        "give them different names, or run them one after the other",
    ),
    "rigel03": Kind(
        "Rigel 0.3 refuses this, or reads it in another way (`rigel check --rigel03`)",
        "change it if Rigel 0.3 must read the file",
    ),
}

#: Single values.
VALUES: Mapping[str, Kind] = {
    "bad-text": Kind("a text does not have the form of its option", "use the form in the message"),
    "bad-number": Kind("a number is outside of its range", "use a number in the range"),
    "bad-quantity": Kind(
        "a value is not a quantity of Kubernetes", "write `250m`, `0.5` or `64Mi`"
    ),
    "bad-port": Kind("a port is not a number from 1 to 65535", "use such a number"),
    "bad-replicas": Kind("a number of pods is not a whole number", "use 0 or more"),
    "bad-count": Kind("a number of messages is not 1 or more", "use 1 or more"),
    "bad-share": Kind("a value is neither a number of pods nor a percentage", "write `1` or `25%`"),
    "bad-duration": Kind("a value is not a duration, or is too short", "write `90s`, `5m` or `1h`"),
    "bad-image": Kind(
        "an image's name, tag or platform is malformed, or does not fit the job",
        "write `REGISTRY/NAME:TAG`",
    ),
    "bad-name": Kind(
        "a name is not one that Kubernetes, the image's system or an attachment accepts",
        "use lower case letters, digits and `-`, or what the message names",
    ),
    "bad-label": Kind(
        "a label's key or value is malformed", "use letters, digits, `-`, `_` and `.`"
    ),
    "bad-env": Kind(
        "a text is not the name of an environment variable",
        "use letters, digits and `_`, no digit first",
    ),
    "bad-path": Kind("a path is not absolute, or has a colon", "begin it with `/`"),
    "bad-ros-name": Kind(
        "a text is not a ROS name", "use letters, digits, `_` and `/`; or set `name` of the node"
    ),
    "bad-uri": Kind("the address of a ROS master is malformed", "write `http://HOST:11311`"),
    "bad-url": Kind("an address is not an http or https URL", "write `http://HOST:PORT`"),
    "bad-address": Kind("an address is not `HOST:PORT`", "write it in this form"),
    "bad-user": Kind("a user is not a number above 0", "use the number of a user other than root"),
    "bad-source": Kind(
        "`network_policy.allow` has something that is not a release or an address",
        "write `RELEASE`, `NAMESPACE/RELEASE`, `NAMESPACE/*` or `192.168.1.0/24`",
    ),
    "bad-range": Kind(
        "an address or a range is malformed, or not inside of `network.subnet`",
        "correct it; ranges are IPv4, such as `10.20.0.0/24`",
    ),
    "bad-domain": Kind(
        "a DDS domain is not 0 to 232, or one whose ports Linux gives to other programs",
        "use 0 to 101, or 215 to 232",
    ),
    "bad-peer": Kind("an entry of `peers` is not a host name or an IPv4 address", "correct it"),
    "bad-registry": Kind("`server` is not the name of a registry", "write `HOST` or `HOST:PORT`"),
    "bad-platform": Kind("a platform is malformed", "write `linux/amd64` or `linux/arm64`"),
    "empty-value": Kind(
        "the user or the password of a registry is empty, for example because its variable is",
        "set the variable; a registry without users needs no provider",
    ),
}

#: Nodes, applications and what runs in their containers.
APPLICATION: Mapping[str, Kind] = {
    "unknown-distro": Kind(
        "the distribution looks misspelled, and is taken for a ROS 1 of your own",
        "correct `application.distro`",
    ),
    "missing-image": Kind("neither the node nor the job has an `image`", "set one of the two"),
    "incomplete": Kind(
        "an option has no effect without another one", "add the option that the message names"
    ),
    "conflict": Kind("two options exclude each other", "remove one of the two"),
    "name-taken": Kind(
        "two things get one name, port or path, or the name of one of ours", "rename one of them"
    ),
    "duplicate-node": Kind(
        "two nodes have one ROS name, or a node of a fixed name has `replicas`",
        "rename one, or set `anonymous: true`",
    ),
    "unknown-node": Kind(
        "an option, or a node laid over a stack's, names a node that does not exist",
        "correct the name",
    ),
    "unknown-volume": Kind(
        "a node mounts a volume that `persistent_storage` does not have",
        "correct the name, or add it",
    ),
    "bad-volume": Kind(
        "a mount has no source, several ones, or no place in the container",
        "set one of `name`, `host_path`, `config_map`, `secret`, `memory`, and `mount_path`",
    ),
    "bad-device": Kind("a device has both `path` and `resource`, or neither", "set one of the two"),
    "device-access": Kind(
        "the container sees a device and may not open it",
        "add `security_context: { privileged: true }` (with `runAsUser: 0` if the image has another"
        " user), or use a device plugin's `resource`",
    ),
    "bad-command": Kind(
        "a command line is empty, or cannot be split into words",
        "correct its quotes, or leave it out",
    ),
    "not-appendable": Kind(
        "parameters or remappings would be lost: nothing can be appended to this command line",
        "set `args`, or `package` and `executable`",
    ),
    "bad-parameter": Kind(
        "a value cannot be a parameter of a component", "use the message's types"
    ),
    "bad-parameter-file": Kind(
        "a parameter file has both `file` and `image_file`, or neither; or the file is missing, too"
        " large, or not a YAML mapping",
        "set one of the two, and correct what the message names; paths begin at `application.dir`",
    ),
    "no-parameter-namespace": Kind(
        "a parameter file of ROS 2 has a `namespace`", "write full names in the file"
    ),
    "no-global-parameters": Kind(
        "the job of a ROS 2 application has global parameters", "set them at the nodes"
    ),
    "unknown-substitution": Kind(
        "an expression such as `$(anon x)` is not supported",
        "use `$(find P)`, `$(env X)` or `$(optenv X D)`",
    ),
    "no-substitution": Kind(
        "an expression is not replaced: `substitution_args` is not set, or does not apply here",
        "set `substitution_args: true`, or write the value",
    ),
    "components": Kind("`components` do not fit this node", "change what the message names"),
    "lifecycle": Kind("`lifecycle` does not fit this node", "change what the message names"),
    "not-ros1": Kind("a nodelet has an option that exists only in ROS 2", "remove it"),
    "not-ros": Kind("an option needs ROS, and this node has `ros: none`", "remove it"),
    "no-master-in-ros2": Kind("a ROS 2 application requests a ROS master", "remove the option"),
    "two-masters": Kind(
        "the job both deploys a ROS master and names another one", "remove one of the two"
    ),
    "no-master": Kind(
        "ROS 1 nodes have no master: none is deployed, none is named",
        "set `ros_master_uri`, unless the image starts roscore",
    ),
    "bad-update": Kind(
        "an option of `update` does not fit its strategy", "remove it, or set the other strategy"
    ),
    "hand-over": Kind(
        "this node cannot hand over",
        "remove the obstacle that the message names, or set `strategy: Recreate`",
    ),
    "no-shell": Kind(
        "`args` have a word that only a shell acts on, and no shell reads them",
        'start a shell: `args: [bash, -c, "source /x/setup.bash && exec rosrun a b"]`',
    ),
    "surge": Kind(
        "an update would run two pods of one node at the same time",
        "leave `strategy` out, or set `anonymous: true`",
    ),
    "two-at-once": Kind(
        "a node is anonymous, so an update runs its old and its new pod at the same time, and the"
        " two disturb each other",
        "set `update: {strategy: Recreate}`, or `{strategy: Rolling}` if two pods may run at once",
    ),
    "own-name": Kind(
        "a tool of ROS 2 names its node itself, so no node has the name of the key",
        "set `anonymous: true`; add `update: {strategy: Recreate}` if two pods must not run at the"
        " same time",
    ),
    "replicas": Kind(
        "the network gives one address to a workload that has several pods",
        "use one pod, or another `ipam` or `network.mode`",
    ),
    "fixed-field": Kind(
        "a patch changes a field by which `rigel` finds the object, or removes a required one",
        "remove it from the patch",
    ),
    "reserved-label": Kind("a label is one that objects are found by", "choose another name"),
    "sidecar": Kind(
        "a patch adds a container to a ROS 2 or DDS pod, where it would have no network settings",
        "make it a node of its own, or set `allow_sidecars: true`",
    ),
    "no-application": Kind(
        "an option is about the Deployment of `application_image`, and the job has only `nodes`",
        "remove it, or set the option of the nodes that the message names",
    ),
    "no-graph": Kind("the ROS graph of zenoh nodes cannot be read", "remove `rollback_on`"),
    "restricted": Kind(
        "an option is not allowed by `security: restricted`", "remove one of the two"
    ),
    "any-machine": Kind(
        "a node has a `host_path` and no fixed machine, so its data are those of whichever machine"
        " its pod runs on",
        "set `placement.node`, or use one of `persistent_storage.volumes` without `host_path`",
    ),
    "volume-owner": Kind(
        "Kubernetes does not change the owner of a machine's directory",
        "run `chown` on the machine, with the user in the message",
    ),
    "not-covered": Kind(
        "`network_policy` does not cover a part of the traffic",
        "protect it in another way, or add the addresses to `network_policy.allow`",
    ),
}

#: Networks.
NETWORK: Mapping[str, Kind] = {
    "network-missing": Kind(
        "a ROS 2 application has no `network`, and most pod networks carry no multicast",
        "set [`network`](networking.md): `peers`, which works everywhere, or `macvlan` if the"
        " machines share an Ethernet; `none` if the cluster's network carries multicast",
    ),
    "no-super-client": Kind(
        "a tool such as `ros2 bag record` runs with discovery servers, which show a node only the"
        " topics that it exchanges data on",
        'set `env: { ROS_SUPER_CLIENT: "TRUE" }` for this node',
    ),
    "one-domain": Kind(
        "a fleet's robots share a wire and a DDS domain",
        'set `domain_id` from the matrix, for example `"{{ data.domain }}"`',
    ),
    "ros1": Kind("an option or a mode does not work with ROS 1", "remove it, or use another mode"),
    "wrong-mode": Kind(
        "the network mode does not work with this distribution or middleware",
        "use [another mode](networking.md#which-mode) or middleware; `peers` works with all of DDS",
    ),
    "foreign-key": Kind("a key of `network` belongs to another mode", "remove it"),
    "image-lacks-rmw": Kind(
        "official ROS images contain Fast DDS only",
        "use an image with the `rmw` package that the message names",
    ),
    "many-participants": Kind(
        "two launch files may each start more programs than `peers` finds in a pod",
        "split the launch file, or use another mode",
    ),
    "too-few-addresses": Kind(
        "there are more pods than addresses", "widen `range_start` and `range_end`, or the subnet"
    ),
    "host-local": Kind(
        "`ipam: host-local` with pods on several machines would assign addresses twice",
        "use `whereabouts`, or pin all nodes to one machine",
    ),
    "no-k3s": Kind("`data_dir` is set and the platform is not k3s", "remove it"),
}

#: Images and their builds.
IMAGES: Mapping[str, Kind] = {
    "bad-compiler": Kind(
        "the compiler does not build this generation of ROS", "use `catkin_make` or `colcon`"
    ),
    "same-node": Kind("a delivery check has one node as both ends", "name two nodes"),
}

#: The observability stack and the ROS exporter.
OBSERVABILITY: Mapping[str, Kind] = {
    "no-ros-metrics": Kind(
        "this application has no graph that the exporter can examine", "set `ros_metrics: false`"
    ),
    "not-used": Kind("an option has no effect with the others", "remove it"),
    "end-of-life": Kind(
        "Promtail, which reads the logs unless you choose, is no longer maintained",
        "set `collector: alloy`, or `collector: promtail` to keep it",
    ),
    "clear-password": Kind(
        "a password stands in the Rigelfile, readable for all who read it",
        "take it from the environment with a template",
    ),
    "missing-url": Kind("the address of a Prometheus is needed and missing", "set its `url`"),
}

#: What a deploy finds before its first write.
REFUSED: Mapping[str, Kind] = {
    "other-release": Kind(
        "an object belongs to another release", "rename it, or remove it from the other release"
    ),
    "immutable": Kind(
        "a field of an existing object cannot be changed",
        "run the `kubectl delete` command in the message, then deploy again",
    ),
    "unknown-kind": Kind(
        "the cluster does not have this kind of object",
        "install what defines it, or remove the option that needs it",
    ),
    "refused": Kind("the API server refuses an object", "change what its message names"),
    "pod-security": Kind(
        "the namespace's Pod Security level does not allow the pods",
        "set `security: restricted`, or use another namespace",
    ),
    "quota": Kind(
        "the release does not fit into a ResourceQuota", "request less, or have the quota raised"
    ),
    "no-resources": Kind(
        "a quota needs `requests` or `limits` of each pod", "set `resources` of the nodes"
    ),
    "limit-range": Kind("resources are outside of a LimitRange", "change `resources`"),
    "policy": Kind(
        "an admission policy or a webhook refuses the pods", "change what its message names"
    ),
    "right": Kind(
        "your account may not do this",
        "`rigel rbac deployer` prints a Role that is enough in the namespace; for a volume with"
        " `host_path`, and for a namespace that does not exist, ask an administrator",
    ),
    "architecture": Kind(
        "none of the chosen machines can run the image's architecture",
        "build it for their `platforms`, or change `placement`",
    ),
}

#: Stacks of Eclipse Muto.
STACKS: Mapping[str, Kind] = {
    "agent-job": Kind(
        "the job that a Muto agent deploys does not fit the agent",
        "change the one that the message names",
    ),
    "bad-agent": Kind(
        "an option of a Muto agent has a value that the agent would refuse",
        "correct it as the message says",
    ),
    "not-a-stack": Kind(
        "the text is not a stack, or not exactly one",
        "use one of the [forms](muto.md#forms-of-stacks): a bare stack, a thing of Ditto,"
        " `stack/json`, a solution of Symphony, `stack/archive`",
    ),
    "unknown-stack": Kind(
        "no file and no Ditto has the stack", "correct its id, or put its file beside the Rigelfile"
    ),
    "not-fetched": Kind(
        "the stack is in Ditto, which `rigel check` does not contact",
        "use `rigel render` to see the nodes",
    ),
    "bad-file": Kind("the stack's file cannot be read", "correct the path or its permissions"),
    "bad-data": Kind("base64, gzip or JSON inside of a stack is damaged", "export the stack again"),
    "stack-cycle": Kind("stacks refer to each other in a circle", "remove one reference"),
    "missing-argument": Kind("`$(arg x)` has no value", "set it in `args`, or with `--arg`"),
    "unknown-argument": Kind("an argument is not one of the stack's", "correct its name"),
    "argument-cycle": Kind("arguments need each other in a circle", "give one a plain value"),
    "no-node": Kind("no node of the stack can be run", "check its `if` and `unless`"),
    "left-out": Kind("`if` or `unless` leaves this node out", ""),
    "not-carried": Kind(
        "something of the stack has no counterpart here", "set what the message names, or ignore it"
    ),
    "needs-container": Kind(
        "a value is known only inside of the container",
        "write the value into the Rigelfile's `nodes`",
    ),
    "unknown-transition": Kind(
        "a lifecycle transition does not exist", "use `configure`, `activate` and so on"
    ),
    "needs-image": Kind(
        "the stack runs a file of a device", "put the file into an image, and start it as a node"
    ),
    "needs-build": Kind(
        "the stack is an archive with sources", "run `rigel muto convert STACK --to DIRECTORY`"
    ),
    "no-archive": Kind(
        "the stack to convert has no archive that is included", "include its `data`"
    ),
    "bad-archive": Kind(
        "the archive is damaged, too large, or has entries that lead out of it", "pack it again"
    ),
    "bad-checksum": Kind("the archive does not have its checksum", "export the stack again"),
    "no-launch-file": Kind("the archive does not contain its launch file", "correct `launch_file`"),
}

#: All kinds of problems with a place in a Rigelfile or a stack, by the title of a group.
PROBLEMS: Mapping[str, Mapping[str, Kind]] = {
    "The file": FILE,
    "Values": VALUES,
    "Nodes and applications": APPLICATION,
    "Networks": NETWORK,
    "Images and delivery checks": IMAGES,
    "Observability": OBSERVABILITY,
    "Stacks of Eclipse Muto": STACKS,
    "Refused by the cluster": REFUSED,
}

#: What `kind` of a pod in `rigel status -o json` may be.
PODS: Mapping[str, Kind] = {
    "away": Kind(
        "Kubernetes cannot reach the pod's machine",
        "switch it on, or connect it; pinned pods continue when it is back",
    ),
    "orphan": Kind(
        "a restarted ROS master has forgotten the pod's node",
        "restart the pod; with `gate: true` roscore"
        " [gets its registrations back](ros1.md#when-roscore-ends)",
    ),
}

#: What `kubectl get pods` shows of a pod that does not run.
KUBECTL: Mapping[str, Kind] = {
    "Pending": Kind(
        "no machine fits the pod, or its image or volumes are not there yet",
        "`rigel status` reports which",
    ),
    "ErrImagePull": Kind(
        "the image cannot be pulled", "check its name, the registry and `image_pull_secrets`"
    ),
    "ImagePullBackOff": Kind(
        "the image cannot be pulled, and Kubernetes waits before it tries again",
        "check its name, the registry and `image_pull_secrets`",
    ),
    "CreateContainerConfigError": Kind(
        "a Secret or a ConfigMap that the container needs does not exist",
        "create it; `rigel status` reports its name",
    ),
    "CrashLoopBackOff": Kind(
        "the program has ended several times, and Kubernetes waits before it starts it again",
        "read its last lines with `rigel logs NODE`, and correct what it runs",
    ),
    "OOMKilled": Kind(
        "the container used more memory than its limit, or than its machine has",
        "raise `resources.limits.memory` of the node",
    ),
    "Evicted": Kind(
        "the machine ran out of memory or disk space", "free memory or disk space there"
    ),
}
