"""Promtail: its configuration, and its objects."""

from __future__ import annotations

import re
from collections.abc import Iterator

import yaml

from rigel_k8s.objects.marks import RELEASE_LABEL
from rigel_k8s.objects.podnodes import NODES_ANNOTATION
from rigel_k8s.objects.pods import Object
from rigel_k8s.observability import lines
from rigel_k8s.observability.names import LABELS
from rigel_stack.manifests.program import ProgramDraft, load
from rigel_stack.manifests.scraping import contract, rules
from rigel_stack.manifests.stack import Stack

PROMTAIL = "promtail"
#: Where it reads the user of a Loki that needs a login.
SECRET = "/etc/promtail-loki"


def promtail(stack: Stack) -> Iterator[Object]:
    config = stack.config_map(PROMTAIL, {"promtail.yaml": configuration(stack)})
    draft = ProgramDraft(stack, PROMTAIL, stack.options.promtail, [config])
    if stack.other_loki and (secret := stack.other_loki.secret):
        draft.pod["volumes"].append({"name": "loki", "secret": {"secretName": str(secret)}})
        login = {"name": "loki", "mountPath": SECRET, "readOnly": True}
        draft.container["volumeMounts"].insert(-1, login)
    return draft.objects()


def configuration(stack: Stack) -> str:
    """Return promtail.yaml."""
    made = load("promtail.yaml")
    made["clients"] = [_client(stack)]
    (scrape,) = made["scrape_configs"]
    if stack.options.collect != "all":
        (pods,) = scrape["kubernetes_sd_configs"]
        pods["selectors"] = [{"role": "pod", "label": RELEASE_LABEL}]
    scrape["relabel_configs"] = [*contract(), name_node(), *rules("log_path")]
    scrape["pipeline_stages"] = list(_stages())
    return yaml.safe_dump(made, sort_keys=False, width=100_000)


def name_node() -> Object:
    """Return the rule for pods with several nodes: a container's workload is its node."""
    note = f"__meta_kubernetes_pod_annotationpresent_{re.sub(r'[^a-z0-9]', '_', NODES_ANNOTATION)}"
    source = [note, LABELS["container"]]
    return {"source_labels": source, "regex": "true;(.+)", "target_label": "workload"}


def _client(stack: Stack) -> Object:
    """Return where lines go; while it does not answer, they wait, and none is dropped."""
    made: Object = {
        "url": f"{stack.loki_url}/loki/api/v1/push",
        "backoff_config": {"min_period": "500ms", "max_period": "5s", "max_retries": 0},
    }
    loki = stack.other_loki
    if loki and loki.tenant:
        made["tenant_id"] = loki.tenant
    if loki and loki.secret:
        made["basic_auth"] = {
            "username_file": f"{SECRET}/username",
            "password_file": f"{SECRET}/password",
        }
    return made


def _stages() -> Iterator[Object]:
    """Yield what makes entries of lines, and finds their level."""
    yield {"cri": {}}
    yield {"replace": {"expression": lines.GOES_ON, "replace": lines.MARKED}}
    yield {
        "multiline": {
            "firstline": lines.FIRST_LINE,
            "max_wait_time": lines.WAIT,
            "max_lines": lines.LONGEST,
        }
    }
    yield {"replace": {"expression": f"({lines.MARK})", "replace": ""}}
    for form in (*lines.LEVEL_FORMS, lines.TRACEBACK):
        yield {"regex": {"expression": form}}
    yield {"template": {"source": "level", "template": lines.LEVEL_TEMPLATE}}
    yield {"labels": {"level": None}}
    yield {"labelallow": [*LABELS, "level"]}
