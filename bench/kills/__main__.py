"""Kill each command at each of its writes, run it again, and print the result of each.

usage: python -m bench.kills --context NAME [--only "first deploy"]
       [--namespace bench-kills]
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Iterator
from functools import partial

import attrs

from bench.kills.killing import MOMENTS, Moment, describe, in_child
from bench.kills.scenarios import (
    SCENARIOS,
    Scenario,
    Snapshot,
    clear,
    delete_namespace,
    run_again,
    take_snapshot,
)
from rigel_k8s.kube.cluster import Cluster

MOST = 200  # writes of one command


@attrs.frozen
class Kill:
    """One kill, and the result of the same command after it."""

    scenario: str
    step: str
    moment: Moment
    result: str


def main() -> int:
    """Kill, print, and return 1 if a command did not complete its work."""
    words = parse_words()
    kills: list[Kill] = []
    for scenario in SCENARIOS:
        if words.only in (None, scenario.name):
            for kill in kill_everywhere(words.context, scenario, words.namespace):
                print(f"{kill.scenario}: {kill.moment} {kill.step}: {kill.result}", flush=True)
                kills.append(kill)
    in_child(words.context, lambda cluster: delete_namespace(cluster, words.namespace))
    wrong = sum(kill.result.startswith("WRONG") for kill in kills)
    print(f"{len(kills)} kills, {wrong} wrong")
    return int(wrong > 0)


def parse_words() -> argparse.Namespace:
    """Read the command line."""
    parser = argparse.ArgumentParser(prog="python -m bench.kills", description=__doc__)
    parser.add_argument("--context", required=True, help="a cluster where stacks may be installed")
    parser.add_argument("--namespace", default="bench-kills", help="is made and deleted")
    parser.add_argument("--only", help="the name of one command, such as `down`")
    return parser.parse_args()


def kill_everywhere(
    context: str, scenario: Scenario, namespace: str, moments: tuple[Moment, ...] = MOMENTS
) -> Iterator[Kill]:
    """Yield a kill at each write of a command, at each moment."""
    wanted = run_undisturbed(context, scenario, namespace)
    for moment in moments:
        for limit in range(1, MOST):
            kill = kill_once(context, scenario, namespace, wanted, limit, moment)
            if kill is None:
                break
            yield kill
    in_child(context, lambda cluster: clear(cluster, scenario, namespace))


def run_undisturbed(context: str, scenario: Scenario, namespace: str) -> Snapshot:
    """Return what a command leaves if it is not killed."""

    def work(cluster: Cluster) -> Snapshot:
        prepare(scenario, namespace, cluster)
        scenario.command(cluster, namespace)
        return take_snapshot(cluster, scenario, namespace)

    wanted: Snapshot = in_child(context, work).result
    return wanted


def prepare(scenario: Scenario, namespace: str, cluster: Cluster) -> None:
    """Create the state before a command."""
    clear(cluster, scenario, namespace)
    scenario.before(cluster, namespace)


def kill_once(
    context: str,
    scenario: Scenario,
    namespace: str,
    wanted: Snapshot,
    limit: int,
    moment: Moment,
) -> Kill | None:
    """Kill a command at one write and run it again; None if it has fewer writes."""
    in_child(context, partial(prepare, scenario, namespace))
    died = in_child(context, lambda c: scenario.command(c, namespace), limit, moment)
    if died.killed is None:
        return None
    result = in_child(context, lambda c: run_again(scenario, c, namespace, wanted)).result
    return Kill(scenario.name, describe(died.killed, namespace), moment, result)


if __name__ == "__main__":
    sys.exit(main())
