"""The OpenTelemetry Collector: its configuration, and its objects.

Labels are resource attributes of its records; Loki's configuration makes labels of them again.
"""

from __future__ import annotations

import json
from collections.abc import Iterator

import yaml

from rigel_k8s.objects.marks import NAME_LABEL, RELEASE_LABEL
from rigel_k8s.objects.naming import ROS_NAME_ANNOTATION
from rigel_k8s.objects.podnodes import NODES_ANNOTATION
from rigel_k8s.objects.pods import Object
from rigel_k8s.observability import lines
from rigel_k8s.observability.names import LABELS
from rigel_stack.manifests.program import ProgramDraft, list_loki_variables, load
from rigel_stack.manifests.stack import Stack

OTEL_COLLECTOR = "otel-collector"
LOGIN = "basicauth/loki"


def otel_collector(stack: Stack) -> Iterator[Object]:
    config = stack.config_map(OTEL_COLLECTOR, {"collector.yaml": configuration(stack)})
    draft = ProgramDraft(stack, OTEL_COLLECTOR, stack.options.otel_collector, [config])
    draft.container["env"] += list_loki_variables(stack)
    return draft.objects()


def configuration(stack: Stack) -> str:
    """Return collector.yaml."""
    made = load("collector.yaml")
    made["receivers"]["file_log"]["operators"] = list(_operators())
    processors, pipeline = made["processors"], made["service"]["pipelines"]["logs"]
    processors["transform/labels"]["log_statements"] = list(_statements())
    metadata = processors["k8s_attributes"]
    metadata["extract"] |= {
        "labels": [
            {"tag_name": "application", "key": RELEASE_LABEL, "from": "pod"},
            {"tag_name": "workload", "key": NAME_LABEL, "from": "pod"},
        ],
        "annotations": [
            {"tag_name": "ros_node", "key": ROS_NAME_ANNOTATION, "from": "pod"},
            {"tag_name": "nodes", "key": NODES_ANNOTATION, "from": "pod"},
        ],
    }
    if stack.options.collect != "all":
        metadata["filter"]["labels"] = [{"key": RELEASE_LABEL, "op": "exists"}]
        # Lines of pods that belong to no release.
        foreign = ['resource.attributes["application"] == nil']
        processors["filter/releases"] = {"error_mode": "ignore", "log_conditions": foreign}
        pipeline["processors"].insert(-1, "filter/releases")
    exporter, loki = made["exporters"]["otlp_http"], stack.other_loki
    exporter["endpoint"] = f"{stack.loki_url}/otlp"
    if loki and loki.tenant:
        exporter["headers"] = {"X-Scope-OrgID": escape(loki.tenant)}
    if loki and loki.secret:
        account = {"username": "${env:LOKI_USER}", "password": "${env:LOKI_PASSWORD}"}
        made["extensions"][LOGIN] = {"client_auth": account}
        made["service"]["extensions"].append(LOGIN)
        exporter["auth"] = {"authenticator": LOGIN}
    return yaml.safe_dump(made, sort_keys=False, width=100_000)


def _operators() -> Iterator[Object]:
    """Yield what makes entries of lines, and finds their level."""
    yield {"type": "container"}
    # The lines of a file are those of both streams, and only lines of one continue each other.
    stream = 'attributes["log.file.path"] + attributes["log.iostream"]'
    yield {"type": "add", "field": "attributes.stream", "value": f"EXPR({stream})"}
    goes_on = " or ".join(
        f"body matches {escape(json.dumps(form))}" for form in (r"^(?:\s|$)", lines.GOES_ON)
    )
    yield {
        "type": "recombine",
        "combine_field": "body",
        "is_first_entry": f"not ({goes_on})",
        "source_identifier": "attributes.stream",
        "max_batch_size": lines.LONGEST,
        "max_log_size": "1MiB",
        "force_flush_period": lines.WAIT,
    }
    for form in (*lines.LEVEL_FORMS, lines.TRACEBACK):
        # It is no error that a line has another form.
        yield {"type": "regex_parser", "regex": escape(form), "on_error": "send_quiet"}
    word = "lower(attributes.level)"
    level = f'attributes.level == nil ? "error" : {json.dumps(lines.LEVEL_WORDS)}[{word}] ?? {word}'
    yield {
        "type": "add",
        "if": "attributes.level != nil or attributes.traceback != nil",
        "field": "resource.level",
        "value": f"EXPR({level})",
    }


def escape(text: str) -> str:
    """Return a text in which the collector replaces no variables."""
    return text.replace("$", "$$")


def _statements() -> Iterator[str]:
    """Yield what leaves only the contract's labels, under their names."""
    for label in ("namespace", "pod", "container"):
        source = f'resource.attributes["k8s.{label}.name"]'
        yield f'set(resource.attributes["{label}"], {source}) where {source} != nil'
    # In a pod with several nodes, a container's workload is its node.
    node, several = 'resource.attributes["container"]', 'resource.attributes["nodes"] != nil'
    yield f'set(resource.attributes["workload"], {node}) where {several}'
    yield f"keep_keys(resource.attributes, {json.dumps([*LABELS, 'level'])})"
    yield "keep_keys(log.attributes, [])"
    yield "set(log.observed_time_unix_nano, 0)"
