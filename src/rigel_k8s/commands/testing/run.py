"""From the deploy into a namespace to its end, which comes whatever happens between."""

from __future__ import annotations

import secrets
from collections.abc import Iterator
from contextlib import contextmanager, nullcontext
from pathlib import Path
from typing import Literal

import attrs

from rigel_k8s import deploy as deploys
from rigel_k8s.app.options import OrchestrationOptions
from rigel_k8s.commands.interruption import interruptible
from rigel_k8s.commands.run import prepare, require_kubeconfig
from rigel_k8s.commands.targets import Release, Warnings
from rigel_k8s.commands.testing.release import ReleaseTests
from rigel_k8s.commands.testing.results import (
    RUN,
    Result,
    collect,
    remove_results,
    write_results,
)
from rigel_k8s.errors import RigelK8sError, UserError
from rigel_k8s.jobs import runner
from rigel_k8s.jobs.job import JobReporter
from rigel_k8s.jobs.steps import list_jobs
from rigel_k8s.jobs.stopping import CancelScope
from rigel_k8s.kube import Cluster, connect
from rigel_k8s.objects.naming import object_name
from rigel_k8s.objects.refs import ObjectRef
from rigel_k8s.release.listing import list_releases
from rigel_k8s.release.survey import describe_namespace
from rigel_k8s.release.types import DeployOptions
from rigel_k8s.report import Reporter
from rigel_k8s.settings import Settings

#: On a namespace that is deleted with all that it contains.
LABEL = "rigel-k8s/test"


@attrs.frozen
class Trial:
    """What is tested, and how.

    Attributes:
        kind: None is what has the name, if it is not both.
        settings: its namespace must exist and have no release, and stays; None: each run makes one,
            and deletes it in the end.
        within: seconds that a test may take, and topics to become as they are expected.
        output: a folder for logs, files of tests, bags, and rigel.xml with the results (JUnit).
        keep: delete nothing.
    """

    kind: Literal["job", "sequence"] | None
    name: str
    settings: Settings
    within: float
    output: Path
    keep: bool = False

    def draw_namespace(self) -> str:
        """Return the namespace of one run."""
        drawn = object_name(f"{self.name}-test-{secrets.token_hex(3)}")
        return self.settings.namespace or drawn

    def prepare(self) -> runner.Prepared:
        """Return what can run in a namespace of its own. Raises UserError, also for no test."""
        settings = attrs.evolve(self.settings, namespace=self.draw_namespace(), tests=True)
        prepared = prepare(self.kind, self.name, settings)
        require_tests(prepared, self.name)
        require_kubeconfig(prepared)
        return prepared


def run_tests(
    trial: Trial,
    prepared: runner.Prepared,
    report: JobReporter,
    results: list[Result] | None = None,
    scope: CancelScope | None = None,
) -> list[Result]:
    """Run a job or a sequence as `run` does, and its tests, then delete all of it.

    Args:
        results: takes what is returned, and is filled also if this raises.
        scope: what stops it; None: Ctrl-C does.

    Raises:
        UserError: the namespace is in use; nothing was deployed.
        JobFailed, Interrupted: as `run`; the logs are in the trial's `output`.
    """
    namespace, output = str(prepared.settings.namespace), trial.output
    own, results = trial.settings.namespace is None, [] if results is None else results
    with (
        connect(prepared.settings) as cluster,
        place_for(cluster, namespace, report, own=own, keep=trial.keep),
    ):
        report.line(f"testing {trial.name} in the namespace {namespace}")
        remove_results(output)
        try:
            runner.run(prepared, report, scope=scope)
            with nullcontext(scope.cancelled) if scope else interruptible() as cancel:
                for found in list_found(cluster, namespace):
                    tests = ReleaseTests(found, report, trial.within, output, cancel)
                    try:
                        tests.run()
                    finally:
                        results += tests.results.values()
        except RigelK8sError as error:
            results.append(Result(trial.name, RUN, "failed", message=error.message))
            raise
        finally:
            collect(cluster, prepared.settings, output, report)
            write_results(results, output)
            report.line(f"results, logs and files are in {output}")
    return results


def list_found(cluster: Cluster, namespace: str) -> list[Release]:
    return [Release(cluster, one.release) for one in list_releases(cluster, namespace)]


def require_tests(prepared: runner.Prepared, name: str) -> None:
    """Raise UserError if no job has a test or an `expect`; what is not known yet may have one."""
    for job in list_jobs(prepared.steps):
        options = prepared.values.preview(job, {}).options
        if options is None:
            return
        if isinstance(options, OrchestrationOptions) and (
            options.expect or any(node.kind == "test" for node in options.nodes.values())
        ):
            return
    raise UserError(
        f"{name} has nothing to test: no node of `kind: test`, and no `expect`",
        hint="add a node that ends with `kind: test`, or what `rigel expect learn` proposes",
    )


@contextmanager
def place_for(
    cluster: Cluster, namespace: str, report: Reporter, *, own: bool, keep: bool
) -> Iterator[None]:
    """Make a namespace if it is to be `own`, and delete what is in it at the end.

    Raises:
        UserError: the namespace does not exist, or has a release.
    """
    ref = ObjectRef("v1", "Namespace", "", namespace)
    if own:
        made = describe_namespace(namespace)
        made["metadata"]["labels"] = {LABEL: "true"}
        cluster.create(made)
    elif cluster.get(ref) is None:
        hint = "leave -n out: a namespace is made, and deleted in the end"
        raise UserError(f"there is no namespace {namespace}", hint=hint)
    elif found := list_releases(cluster, namespace):
        raise UserError(
            f"the namespace {namespace} has the release {found[0].release.name}: what is tested"
            " would be deleted in the end",
            hint="test in another namespace; without -n one is made",
        )
    try:
        yield
    finally:
        if keep:
            report.line(
                f"the namespace {namespace} is kept: look with `rigel -n {namespace} status`"
            )
        else:
            report.line("deleting what was tested")
            options = DeployOptions(report=Warnings())
            try:
                for one in list_found(cluster, namespace):
                    deploys.down(cluster, one.id, options, volumes=True)
                if own:
                    cluster.delete(ref)
            except BaseException:
                report.warn(
                    f"the namespace {namespace} is left with what is in it; delete it:"
                    f" kubectl delete namespace {namespace}"
                )
                raise
