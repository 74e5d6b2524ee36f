"""Commands on one release: the last one wins, none is lost, and states are true."""

from __future__ import annotations

import threading
from collections.abc import Callable
from typing import Any

import pytest

from rigel_k8s.errors import ClusterError, NotFoundError, RigelK8sError
from rigel_k8s.kube.failures import Forbidden
from rigel_k8s.objects.refs import ObjectRef
from rigel_k8s.release.revisions import history
from rigel_k8s.settings import Settings
from rigel_muto.agent.allowance import Allowance
from rigel_muto.agent.commands import Deploy, Kill, Outcome, Stage, Unavailable
from rigel_muto.agent.memory import Memory
from rigel_muto.agent.wanted import Record, Wanted
from rigel_muto.execution import executor as executors
from rigel_muto.execution.executor import ReleaseExecutor, describe
from rigel_muto.execution.target import DeployedJob, describe_revision
from tests.support.controllers import crash_status, running, unready
from tests.support.releases import down, rollback
from tests.support.until import until

from .conftest import RELEASE, Agent, stack


def settle(executor: ReleaseExecutor) -> None:
    """Wait until the agent has looked at what it has deployed: it stores the revision."""
    until(lambda: executor.record.revision > 0, "a look at the release")


def test_a_stack_is_started_by_its_id(agent: Agent) -> None:
    """It is active only when it is ready."""
    outcome = agent.run().submit(Deploy(stack_id="org:a"))
    assert outcome.succeeded
    agent.until("org:a", "active")
    assert agent.states == [("", "idle"), ("org:a", "starting"), ("org:a", "active")]
    assert agent.nodes == {"a", "both"}
    [revision] = history(agent.fake, RELEASE)  # type: ignore[arg-type]
    assert (revision.number, revision.status) == (1, "good")
    assert revision.description == "muto: org:a"


def test_another_stack_leaves_common_nodes_as_they_are(
    agent: Agent, pods: Callable[[str], str]
) -> None:
    executor = agent.run()
    executor.submit(Deploy(stack_id="org:a"))
    agent.until("org:a", "active")
    before = pods("both")
    executor.submit(Deploy(stack_id="org:b"))
    agent.until("org:b", "active")
    assert agent.nodes == {"b", "both"}
    assert pods("both") == before


def test_kill_takes_the_stack_away(agent: Agent) -> None:
    """A kill of another stack, or of one more that is gone, changes nothing."""
    executor = agent.run()
    executor.submit(Deploy(stack=stack("org:whole", "c"), stack_id="org:whole"))
    agent.until("org:whole", "active")
    assert executor.submit(Kill(stack_id="org:other")).stage == Stage.DONE
    assert agent.nodes == {"c"}
    assert executor.submit(Kill(stack_id="org:whole")).succeeded
    agent.until("org:whole", "killed")
    assert agent.nodes == set()
    executor.submit(Kill())
    until(lambda: agent.states[-1][1] == "killed" and len(agent.states) > 5, "the second kill")


def test_after_a_kill_only_the_named_stack_runs(agent: Agent) -> None:
    executor = agent.run()
    executor.submit(Deploy(stack_id="org:a"))
    agent.until("org:a", "active")
    executor.submit(Kill())
    agent.until("org:a", "killed")
    executor.submit(Deploy(stack_id="org:b"))
    agent.until("org:b", "active")
    assert agent.nodes == {"b", "both"}


def test_a_stack_without_an_id_is_remembered(agent: Agent) -> None:
    """An agent that starts again has it, and can end it."""
    text = stack("", "c")
    executor = agent.run()
    executor.submit(Deploy(stack=text))
    agent.until("", "active")
    settle(executor)
    executor.close()
    again = agent.run()
    assert again.record.wanted.stack == text
    again.submit(Kill())
    agent.until("", "killed")
    assert agent.nodes == set()


def test_components_of_symphony_come_and_go_by_themselves(agent: Agent) -> None:
    executor = agent.run()
    executor.submit(Deploy(components={"one": stack("org:1", "a")}))
    executor.submit(Deploy(components={"two": stack("org:2", "b")}))
    agent.until("one, two", "active")
    assert agent.nodes == {"a", "b"}
    states = executor.look(("one", "three"))
    assert [(name, state.ready, state.stack) for name, state in states.items()] == [
        ("one", True, stack("org:1", "a"))
    ]
    executor.submit(Kill(components=("one",)))
    agent.until("two", "active")
    assert agent.nodes == {"b"}
    assert executor.submit(Kill(components=("one",))).stage == Stage.DONE
    executor.submit(Kill(components=("two",)))
    agent.until("two", "killed")
    assert agent.nodes == set()


def test_a_duplicate_has_no_effect(agent: Agent) -> None:
    """Also after a restart of the agent; the sender of an older one learns that it is over."""
    executor = agent.run()
    executor.submit(Deploy(identity="1", stack_id="org:a"))
    agent.until("org:a", "active")
    executor.submit(Deploy(identity="2", stack_id="org:b"))
    agent.until("org:b", "active")
    settle(executor)
    executor.close()
    agent.fake.calls.clear()
    again = agent.run()
    assert again.submit(Deploy(identity="1", stack_id="org:a")).stage == Stage.SUPERSEDED
    assert again.submit(Deploy(identity="2", stack_id="org:a")).stage == Stage.DONE
    assert agent.fake.writes == []
    again.submit(Kill())
    assert again.submit(Deploy(identity="2", stack_id="org:a")).stage == Stage.SUPERSEDED


def test_a_newer_command_ends_the_wait_of_the_one_before(agent: Agent) -> None:
    """That one never becomes ready, and would be waited for half a minute."""
    controllers: Any = agent.fake.store.controllers
    controllers.kubelet = lambda pod: running(pod) if names(pod, "b") else unready(pod)
    executor = agent.run()
    assert (
        executor.submit(Deploy(stack=stack("org:never", "a"), stack_id="org:never")).stage
        == Stage.ACCEPTED
    )
    executor.submit(Deploy(stack=stack("org:b", "b"), stack_id="org:b"))
    agent.until("org:b", "active")
    assert agent.nodes == {"b"}
    assert ("org:never", "failed") not in agent.states


def test_the_same_stack_again_does_not_begin_anew(agent: Agent) -> None:
    """Symphony applies what is not ready again and again, each time with another identity."""
    controllers: Any = agent.fake.store.controllers
    controllers.kubelet = unready
    executor = agent.run()
    executor.submit(Deploy(identity="1", components={"one": stack("org:a", "a")}))
    agent.fake.calls.clear()
    again = executor.submit(Deploy(identity="2", components={"one": stack("org:a", "a")}))
    assert again.stage == Stage.ACCEPTED
    assert agent.fake.writes == []
    controllers.kubelet = running
    agent.until("one", "active")


def names(pod: Any, name: str) -> bool:
    return bool(pod["metadata"]["labels"]["app.kubernetes.io/name"] == name)


def test_a_cause_is_told_once() -> None:
    """The details of an error repeat it with the workload's name, once for each container."""
    cause = "image a:1 cannot be pulled"
    details = [f"Deployment m: {cause}", f"Deployment m: {cause}", "Deployment n: no room\nnode1"]
    error = RigelK8sError(f"m did not become ready: {cause}", details=details, hint="look at m")
    assert describe(error) == (
        f"m did not become ready: {cause}; Deployment n: no room; node1; look at m"
    )


def test_an_agent_finishes_what_the_one_before_has_begun(agent: Agent) -> None:
    """The command was stored before it was acknowledged."""
    controllers: Any = agent.fake.store.controllers
    controllers.kubelet = unready
    first = agent.run()
    first.submit(Deploy(stack=stack("org:a", "a"), stack_id="org:a"))
    first.close()
    assert agent.states[-1] == ("org:a", "starting")
    controllers.kubelet = running
    agent.run()
    agent.until("org:a", "active")
    assert [r.status for r in history(agent.fake, RELEASE)] == ["interrupted", "good"]  # type: ignore[arg-type]


def test_what_is_no_longer_ready_is_no_longer_active(agent: Agent) -> None:
    """Until it is ready again."""
    agent.run().submit(Deploy(stack=stack("org:a", "a"), stack_id="org:a"))
    agent.until("org:a", "active")
    controllers: Any = agent.fake.store.controllers
    (pod,) = agent.fake.list("v1", "Pod", "n")
    controllers.kubelet = crash_status
    agent.fake.delete(ObjectRef("v1", "Pod", "n", pod["metadata"]["name"]))
    agent.until("org:a", "failed")
    (pod,) = agent.fake.list("v1", "Pod", "n")
    controllers.kubelet = running
    agent.fake.delete(ObjectRef("v1", "Pod", "n", pod["metadata"]["name"]))
    agent.until("org:a", "active")


def test_what_does_not_become_ready_has_failed_until_it_does(agent: Agent) -> None:
    """With the cause, as `rigel status` has it."""
    controllers: Any = agent.fake.store.controllers
    controllers.kubelet = unready
    executor = agent.run(timeout=0.5)
    executor.submit(Deploy(stack=stack("org:a", "a"), stack_id="org:a"))
    agent.until("org:a", "failed")
    assert "1 of 1 not ready within" in executor.record.cause
    controllers.kubelet = running
    agent.until("org:a", "active")
    assert executor.record.cause == ""


def test_what_others_deploy_is_not_the_agents(agent: Agent) -> None:
    """`rigel rollback`, say; all is ready then, and it is another stack."""
    executor = agent.run()
    for name in ("a", "b"):
        executor.submit(Deploy(stack=stack(f"org:{name}", name), stack_id=f"org:{name}"))
        agent.until(f"org:{name}", "active")
    settle(executor)
    rollback(agent.fake, RELEASE, 1, report=agent.report)  # type: ignore[arg-type]
    foreign = "revision 3 of the release is not from this command"
    until(lambda: agent.causes[-1] == foreign, foreign)  # earlier: its pods are not ready yet
    assert agent.states[-1] == ("org:b", "failed")
    down(agent.fake, RELEASE, volumes=False, report=agent.report)  # type: ignore[arg-type]
    executor.submit(Deploy(stack_id="org:a"))
    agent.until("org:a", "active")
    with agent.looking:  # in the middle of it there would be another cause
        down(agent.fake, RELEASE, volumes=False, report=agent.report)  # type: ignore[arg-type]
    agent.until("org:a", "failed")
    assert "there is no release robot" in executor.record.cause


def test_what_kubernetes_refuses_has_failed_with_the_cause(agent: Agent) -> None:
    """The stack before runs on, and is not taken for the new one."""
    executor = agent.run()
    executor.submit(Deploy(stack=stack("org:a", "a"), stack_id="org:a"))
    agent.until("org:a", "active")
    agent.fake.store.rules = [{"apiGroups": ["*"], "resources": ["*"], "verbs": ["get", "list"]}]
    outcome = executor.submit(Deploy(stack=stack("org:b", "b"), stack_id="org:b"))
    assert outcome.stage == Stage.FAILED
    assert "right(s) are missing" in outcome.text
    agent.until("org:b", "failed")
    assert executor.record.cause == outcome.text
    executor._look_again()
    assert executor.record.state == "failed"
    assert agent.nodes == {"a"}


@pytest.mark.parametrize(
    ("command", "words"),
    [
        (Deploy(stack_id="org:nowhere"), 'no stack "org:nowhere"'),
        (Deploy(stack_id="../b.json"), "is not the id of a stack"),
        (Deploy(stack_id="https://evil/api/2/things/a"), "is not the id of a stack"),
        (Deploy(stack="{"), "stack:2:1: this is not YAML"),
        (Deploy(stack='{"node": []}'), "no node"),
        (Deploy(components={"one": "no stack"}), "must be a mapping"),
        (
            Deploy(stack=stack("org:a", "a", stack=[{"thingId": "org:gone"}]), stack_id="org:a"),
            "org:gone",
        ),
    ],
)
def test_what_is_no_stack_is_refused(agent: Agent, command: Deploy, words: str) -> None:
    """With the cause, and nothing has changed: neither the cluster nor the last command."""
    executor = agent.run()
    executor.submit(Deploy(stack=stack("org:a", "a"), stack_id="org:a"))
    agent.until("org:a", "active")
    settle(executor)
    agent.fake.calls.clear()
    outcome = executor.submit(command)
    assert outcome.stage == Stage.REFUSED
    assert words in outcome.text
    assert " | " not in outcome.text, "no lines of a file"
    assert agent.fake.writes == []
    assert agent.states[-1] == ("org:a", "active")


@pytest.mark.parametrize(
    ("allowance", "command", "words"),
    [
        (Allowance(), Deploy(stack=stack("org:a", "a"), stack_id="org:a"), "whole stack"),
        (Allowance(), Deploy(components={"one": stack("org:a", "a")}), "whole stack"),
        (
            Allowance(stacks=("org:b",)),
            Deploy(stack_id="org:a"),
            'stack "org:a" is not allowed',
        ),
        (
            Allowance(images=("other/*",)),
            Deploy(stack_id="org:a"),
            "is not allowed: images: other/*",
        ),
    ],
)
def test_what_is_not_allowed_is_refused(
    agent: Agent, allowance: Allowance, command: Deploy, words: str
) -> None:
    outcome = agent.run(allowance).submit(command)
    assert outcome.stage == Stage.REFUSED
    assert words in outcome.text
    assert agent.nodes == set()


def test_what_is_allowed_is_deployed(agent: Agent) -> None:
    allowance = Allowance(stacks=("org:*",), images=("lab/*",))
    assert agent.run(allowance).submit(Deploy(stack_id="org:a")).succeeded
    agent.until("org:a", "active")


def test_a_namespace_is_created_where_the_job_names_it(agent: Agent) -> None:
    """With the first command, whose record comes before its deploy; not another one of `-n`."""
    agent.fake.store.objects.pop(ObjectRef("v1", "Namespace", "", "n"))
    elsewhere = Settings(rigelfile=agent.directory / "Rigelfile", namespace="other")
    assert not DeployedJob(elsewhere, agent.report).creates_namespace()
    with pytest.raises(NotFoundError):
        Memory(agent.fake, RELEASE).store(Record())  # type: ignore[arg-type]
    assert agent.run().submit(Deploy(stack_id="org:a")).succeeded
    agent.until("org:a", "active")


def test_an_agent_without_the_right_to_store_refuses(
    agent: Agent, monkeypatch: pytest.MonkeyPatch
) -> None:
    """To wait for the right would keep all later commands waiting."""
    executor = agent.run()

    def fail(*_: Any, **__: Any) -> None:
        raise Forbidden("you may not write Secrets")

    monkeypatch.setattr(type(agent.fake), "apply", fail)
    outcome = executor.submit(Deploy(stack_id="org:a"))
    assert (outcome.stage, outcome.text) == (Stage.REFUSED, "you may not write Secrets")


def test_a_command_that_cannot_be_stored_is_not_begun(
    agent: Agent, monkeypatch: pytest.MonkeyPatch
) -> None:
    """It comes again, and is no duplicate then."""
    executor = agent.run()

    def fail(*_: Any, **__: Any) -> None:
        raise ClusterError("the API server is away")

    with monkeypatch.context() as away:
        away.setattr(type(agent.fake), "apply", fail)
        with pytest.raises(Unavailable, match="the API server is away"):
            executor.submit(Deploy(identity="1", stack_id="org:a"))
    assert agent.states == [("", "idle")]
    assert executor.submit(Deploy(identity="1", stack_id="org:a")).succeeded
    agent.until("org:a", "active")


def test_a_command_that_never_began_is_answered_when_a_newer_one_comes(
    agent: Agent, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Its sender does not wait for the end of its patience."""
    monkeypatch.setattr(executors, "PATIENCE", 600)
    with monkeypatch.context() as unstarted:
        unstarted.setattr(ReleaseExecutor, "start", lambda self: None)
        executor = agent.run()
    answers: list[Outcome] = []
    kill = threading.Thread(target=lambda: answers.append(executor.submit(Kill())), daemon=True)
    kill.start()
    until(lambda: executor._turns._next is not None, "the kill waits for its turn")
    newer = Deploy(stack_id="org:a")
    threading.Thread(target=lambda: executor.submit(newer), daemon=True).start()
    kill.join(30)
    assert [one.stage for one in answers] == [Stage.ACCEPTED]
    executor.start()
    agent.until("org:a", "active")


def test_a_description_is_one_readable_line() -> None:
    """A stack's id is a text of another machine, and `rigel history` prints it."""
    assert describe_revision(Wanted(stack_id="org:a\x1b[2J\nb")) == "muto: org:a\ufffd[2J\ufffdb"
    assert describe_revision(Wanted(components={"arm": "{}", "base": "{}"})) == "muto: arm, base"
    assert describe_revision(Wanted(stack="{}")) == "muto"
    assert len(describe_revision(Wanted(stack_id="x" * 9999))) < 300
