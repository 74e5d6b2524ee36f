"""The job that deploys the agent that executes commands of Eclipse Muto."""

from __future__ import annotations

import json
import os
from collections.abc import Iterator, Mapping, Sequence
from typing import TYPE_CHECKING, Any, ClassVar

from rigel_k8s import rigelfile as grammar
from rigel_k8s.app.application import flat
from rigel_k8s.app.deploying.target import release_key, release_of
from rigel_k8s.app.generation import GENERATIONS
from rigel_k8s.app.rights import PURPOSES, read_rights
from rigel_k8s.jobs.deploying import deploy
from rigel_k8s.jobs.job import JobContext
from rigel_k8s.jobs.names import index_by_name
from rigel_k8s.objects.rights import make_rules
from rigel_k8s.objects.workloads import ReleaseContext
from rigel_k8s.option_text import has_template
from rigel_k8s.problems import Problem
from rigel_k8s.release.types import Desired
from rigel_k8s.rigelfile.model import ComponentSpec, Rigelfile
from rigel_k8s.settings import Application, Settings
from rigel_muto.agent.allowance import matches
from rigel_muto.agent.manifests import agent_objects
from rigel_muto.agent.options import MutoAgent, check_options

if TYPE_CHECKING:
    from rigel_k8s.kube.cluster import Cluster
    from rigel_k8s.release.part import Part
    from rigel_k8s.release.types import ReleaseId


class MutoAgentJob:
    """Deploys the agent, and waits until it is connected to its broker."""

    options: ClassVar[type[MutoAgent]] = MutoAgent
    needs_cluster: ClassVar[bool] = True

    def check(self, options: MutoAgent, application: Application) -> Sequence[Problem]:
        """Return values that the agent would refuse."""
        return list(check_options(options))

    def check_jobs(
        self, options: MutoAgent, jobs: Mapping[str, ComponentSpec]
    ) -> Sequence[Problem]:
        """Return what is wrong with the job that commands deploy; it is another of the file."""
        if has_template(options.job):
            return ()
        return list(check_deployed_job(options, jobs))

    def exclusive(
        self, options: MutoAgent, application: Application, settings: Settings
    ) -> str | None:
        """Return the agent's release."""
        return release_key(options, settings)

    def release(
        self, options: MutoAgent, settings: Settings, cluster: Cluster | None
    ) -> ReleaseId | None:
        """Return the agent's release."""
        return release_of(options, settings, cluster)

    def parts(self, options: MutoAgent, job: JobContext, cluster: Cluster | None) -> Sequence[Part]:
        from rigel_k8s.release.part import Part

        rigelfile = grammar.load(job.settings.rigelfile, os.environ)
        release = release_of(options, job.settings, cluster)
        context = ReleaseContext(release.namespace, release.name, "", GENERATIONS["none"])
        rules = make_rules(read_rights(PURPOSES["deployer"], release.namespace))
        text = write_rigelfile(rigelfile, rigelfile.jobs[options.job])
        desired = Desired(
            release,
            tuple(agent_objects(context, options, text, rules)),
            create_namespace=options.namespace == release.namespace,
        )
        return [Part(desired=desired, place=job.place)]

    def run(self, options: MutoAgent, job: JobContext) -> None:
        """Deploy. Raises as jobs.deploying.deploy."""
        deploy(self, options, job)
        release = release_of(options, job.settings)
        job.report.line(
            f"{release.name} in {release.namespace} accepts commands for {options.thing}"
        )


def check_deployed_job(options: MutoAgent, jobs: Mapping[str, ComponentSpec]) -> Iterator[Problem]:
    """Yield what is wrong with the job that commands deploy."""
    spec = jobs.get(options.job)
    if spec is None or spec.plugin not in index_by_name("job")["orchestration"].names:
        message = f'the Rigelfile has no orchestration job "{options.job}"'
        yield Problem(("job",), message, "unknown-job")
        return
    keys = grammar.strip_places(spec.options)
    own = str(options.deployment_name)
    if own in find_values(keys, "deployment_name"):
        message = (
            f'the job {spec.name} and the agent have the same deployment_name, "{own}": a kill'
            " would remove the agent; give one of them another"
        )
        yield Problem(("job",), message, "agent-job")
    yield from check_fit(options, spec.name, keys)
    nodes = flat(keys).get("nodes")
    mounted = isinstance(nodes, dict) and any("files" in (one or {}) for one in nodes.values())
    for key, instead, found in (
        ("parameter_files", "`parameters`", any(find_values(keys, "parameter_files"))),
        ("files", "`volumes`", mounted),
    ):
        if found:
            message = f"the job {spec.name} has {key}, which the agent's pod does not have"
            yield Problem(("job",), f"{message}: write {instead} instead", "agent-job")


def check_fit(options: MutoAgent, job: str, keys: Mapping[str, Any]) -> Iterator[Problem]:
    """Yield what the agent would do otherwise than `rigel run job` with the same job."""
    own = flat(keys)
    namespace, image = str(own.get("namespace") or ""), str(own.get("image") or "")
    other = namespace != str(options.namespace or "") and not has_template(namespace)
    if namespace and other:
        message = (
            f'the agent deploys into its own namespace, not into "{namespace}", which the job'
            f" {job} names: name the same one"
        )
        yield Problem(("namespace",), message, "agent-job", severity="warning")
    allowed = options.images
    if allowed is not None and image and not has_template(image) and not matches(image, allowed):
        message = f'no pattern allows "{image}", the image of the job {job}: add one'
        yield Problem(("images",), message, "agent-job", severity="warning", at_key=True)


def find_values(value: Any, key: str) -> Iterator[Any]:
    """Yield the values of a key, wherever it is nested."""
    if isinstance(value, dict):
        for own, inner in value.items():
            if own == key:
                yield inner
            else:
                yield from find_values(inner, key)


def write_rigelfile(rigelfile: Rigelfile, spec: ComponentSpec) -> str:
    """Return a Rigelfile with one job only, its variables filled in: a pod does not have them."""
    job = {"plugin": spec.plugin, "with": grammar.strip_places(spec.options)}
    application = {"distro": rigelfile.application.distro}
    whole = {"application": application, "jobs": {spec.name: job}}
    return json.dumps(whole, indent=2) + "\n"
