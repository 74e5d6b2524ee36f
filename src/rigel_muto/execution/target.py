"""The release that commands deploy: a job of a Rigelfile with another stack in it."""

from __future__ import annotations

import threading
from collections.abc import Iterator, Mapping
from typing import Any

import attrs

from rigel_graph.reading import read_graph
from rigel_graph.ros1 import list_parameters, read_parameter
from rigel_k8s import deploy as deploys
from rigel_k8s import rigelfile as grammar
from rigel_k8s.app.deploying.target import release_of
from rigel_k8s.app.options import OrchestrationOptions
from rigel_k8s.commands.rigelfiles import load
from rigel_k8s.commands.targets import Jobs, read_jobs, spec_keys
from rigel_k8s.errors import UserError
from rigel_k8s.jobs import runner
from rigel_k8s.jobs.job import JobReporter
from rigel_k8s.jobs.runner import Prepared
from rigel_k8s.jobs.steps import list_jobs
from rigel_k8s.jobs.stopping import CancelScope
from rigel_k8s.kube import Cluster, connect
from rigel_k8s.release import status as states
from rigel_k8s.release.types import DeployOptions, ReleaseId
from rigel_k8s.rigelfile.model import JobUse
from rigel_k8s.rigelfile.source import Source, YamlNode, node_of
from rigel_k8s.settings import Settings
from rigel_muto.agent.commands import Query
from rigel_muto.agent.wanted import Wanted
from rigel_muto.execution.questions import NOT_FOUND, answer, require
from rigel_muto.reading import read
from rigel_muto.remarks import Unreadable

#: Characters of a stack's id that a revision's description has.
LONGEST_LABEL = 200
#: The key that nests a job's options in the form of src.plugin.
NESTED = OrchestrationOptions.nested_under


@attrs.frozen
class DeployedJob:
    """What an agent deploys into.

    Attributes:
        job: the job with images, network and placement; None: the only one that deploys.
        twin: keys of the job's `muto` that the agent sets: twin_url, token, user, password.
    """

    settings: Settings
    report: JobReporter
    job: str | None = None
    twin: Mapping[str, str] = attrs.field(factory=dict)

    def find_release(self, cluster: Cluster) -> ReleaseId:
        """Return the release that the job names."""
        return release_of(self._read_names(), self.settings, cluster)

    def creates_namespace(self) -> bool:
        """Return whether a deploy creates its namespace: the job names it."""
        named = self._read_names().namespace
        return named is not None and self.settings.namespace in (None, named)

    def _read_names(self) -> Any:
        jobs = read_jobs(self.settings)
        return jobs.read_names(jobs.choose(self.job))

    def prepare(self, wanted: Wanted) -> tuple[Prepared, tuple[str, ...]]:
        """Return the job with a stack in it, checked, and the images that the options name.

        A Ditto with the stack is asked now, and not again during the deploy.

        Raises:
            ProblemsError, UserError: the stack, or the job with it, is wrong.
            RigelK8sError: the Ditto cannot be reached.
        """
        rigelfile = load(self.settings)
        spec = Jobs(rigelfile, self.settings).choose(self.job).spec
        own = spec_keys(spec)
        muto = own.get("muto") or (own.get(NESTED) or {}).get("muto") or {}
        muto = muto if isinstance(muto, dict) else {}
        keys = node_of({**muto, **self.twin, "stack": wanted.stack_id}, spec.options)
        if wanted.text is not None:
            keys.value["stack"] = read_stack(wanted.text)
        override = attrs.evolve(spec.options, value={"muto": keys})
        settings = attrs.evolve(self.settings, description=describe_revision(wanted))
        prepared = runner.prepare_use(rigelfile, JobUse(spec.name, override), settings)
        (job,) = list_jobs(prepared.steps)
        made = prepared.values.realise(job, {})  # as the check has made it, and the run uses it
        return prepared, tuple(list_images(made.options))

    def deploy(self, prepared: Prepared, scope: CancelScope, applied: threading.Event) -> None:
        """Deploy as `rigel run job` does.

        Raises:
            JobFailed: its cause is chained.
            Interrupted: the scope was cancelled.
        """
        for warning in prepared.warnings:
            self.report.warn(warning)
        runner.run(prepared, self.report, scope=scope, applied=applied)

    def remove(self, cancel: threading.Event) -> None:
        """Remove the release as `rigel down` does; volumes stay.

        Raises: as rigel_k8s.deploy.down.
        """
        with connect(self.settings) as cluster:
            cluster.endure(self.report.line, cancel)
            options = DeployOptions.of(self.settings, self.report, cancel)
            deploys.down(cluster, self.find_release(cluster), options, volumes=False)

    def look(self) -> tuple[int, list[str]]:
        """Return the release's newest revision, and why it is not ready.

        Raises:
            ClusterError: the cluster cannot be reached.
        """
        with connect(self.settings) as cluster:
            try:
                found = states.status(cluster, self.find_release(cluster))
            except UserError as error:
                return 0, [error.message]
        faults = [f"{one.name}: {one.message}" for one in found.workloads if not one.ok]
        return found.revision, faults

    def answer(self, query: Query) -> Any:
        """Return the answer to a question about what runs.

        Raises:
            UserError: this agent does not answer such a question, or nothing runs.
            ClusterError: the graph or the master cannot be read.
        """
        if query.kind == "ros/topic/echo":
            raise UserError(
                "this agent does not forward messages of topics",
                hint="see them with `rigel exec NODE rostopic echo TOPIC`",
            )
        with connect(self.settings) as cluster:
            release = self.find_release(cluster)
            if query.kind == "ros/param":
                return {"params": list_parameters(cluster, release)}
            if query.kind == "ros/param/get":
                name = require(query, "param")
                found = read_parameter(cluster, release, name)
                return {"name": name, "value": found[0]} if found else NOT_FOUND
            return answer(query, read_graph(cluster, release))


def list_images(options: Any) -> Iterator[str]:
    """Yield the images that a job's options name."""
    nodes = [node.image for node in options.nodes.values()]
    named = (options.image, options.application_image, options.ros_master_image, *nodes)
    yield from dict.fromkeys(str(image) for image in named if image)


def describe_revision(wanted: Wanted) -> str:
    """Return what `rigel history` shows of a stack, whose id anyone may have written."""
    label = "".join(one if one.isprintable() else "\ufffd" for one in wanted.label)
    return f"muto: {label[:LONGEST_LABEL]}" if label else "muto"


def read_stack(text: str) -> YamlNode:
    """Return a stack's text as a value, in which braces are text.

    Raises:
        ProblemsError: it is neither JSON nor YAML.
    """
    source = Source("stack", text)
    try:
        return read(source)
    except Unreadable as fault:
        raise grammar.problems_error(source, [fault.remark.finding]) from fault
