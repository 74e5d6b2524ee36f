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
from rigel_k8s.observability.manifests import otelcollector as lines
from rigel_k8s.observability.manifests.program import ProgramDraft, list_loki_variables, load
from rigel_k8s.observability.manifests.stack import Stack
from rigel_k8s.observability.names import LABELS

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


#: Put before a line that continues an entry although it is not indented, and removed when it is
#: joined: an expression of Go cannot match "any line except these".
MARK = r"\x01"
#: The same, put there by a template.
MARKED = '{{ "\\x01" }}{{ .Value }}'
#: The end of a Python traceback: an exception's name and message, and the text between two of them.
GOES_ON = (
    r"^((?:[A-Za-z_]\w*\.)*[A-Z]\w*(?:Error|Exception|Interrupt|Exit|Iteration|Warning|Timeout)"
    r"(?:: .*)?$"
    r"|During handling of the above exception, another exception occurred:$"
    r"|The above exception was the direct cause of the following exception:$)"
)
#: The beginning of an entry: a line that is neither marked nor indented nor empty.
FIRST_LINE = rf"^[^\s{MARK}]"
#: How long a line waits for lines that continue it.
WAIT = "1s"
#: Lines of one entry at most.
LONGEST = 1000

COLOURS = r"(?:\x1b\[[0-9;]*m)*"
#: What roslaunch and ros2 launch put before a process' lines: [talker-1].
PROCESS = r"(?:\[[^\]\s]+-\d+\] *)?"
START = rf"(?i)^{COLOURS}\s*{PROCESS}{COLOURS}"
WORDS = "trace|debug|info|warn|warning|error|critical|fatal"
#: Each finds a level, or nothing; no line has two of these forms.
LEVEL_FORMS = (
    # ROS 1 ([INFO] [1700000000.1]: ..., [ INFO]), ROS 2, and what launches them.
    rf"{START}\[ *(?P<level>{WORDS}) *\]",
    # rosmaster and other loggers of Python: [rosmaster.main][INFO] ..., ERROR:root: ...
    rf"{START}\[[\w./]+\]\[(?P<level>{WORDS})\]",
    rf"{START}(?P<level>{WORDS}):",
    # zenoh's router, and others of Rust.
    rf"{START}\d{{4}}-\d\d-\d\d[T ][\d:.,]+(?:Z|[+-]\d\d:?\d\d)? +(?P<level>{WORDS})\b",
    # Fast DDS.
    rf"{START}(?:\d{{4}}-\d\d-\d\d [\d:.]+ )?\[\w+ (?P<level>info|warning|error)\]",
    # The stack's own parts.
    rf"{START}(?:(?:ts|time)=\S+ .*?)?\blevel=(?P<level>{WORDS})\b",
)
#: A traceback that was printed without logging.
TRACEBACK = r"^(?P<traceback>Traceback) \(most recent call last\):"
#: From the word that was found to one of names.LEVELS.
LEVEL_WORDS = {"warning": "warn", "critical": "fatal", "trace": "debug"}
#: The same as a template of Promtail.
LEVEL_TEMPLATE = (
    '{{ $word := ToLower (or .level "") }}{{ if not $word }}{{ if .traceback }}error{{ end }}'
    + "".join(f'{{{{ else if eq $word "{word}" }}}}{level}' for word, level in LEVEL_WORDS.items())
    + "{{ else }}{{ $word }}{{ end }}"
)
