"""Dashboards for Grafana and rules for Prometheus, as files that ship with the package.

They are texts: the stack puts them into ConfigMaps, and people load them into a Grafana or a
Prometheus of their own. The rules are written by hand. `python -m tools.boards` writes the
dashboards' JSON; it is in the repository, so a review shows what is deployed. This package does not
depend on clusters, Rigelfiles or options.
"""

from __future__ import annotations

from importlib.resources import files

__all__ = ["LOGS", "METRICS", "dashboards", "rules"]

#: UIDs of the datasources that the dashboards choose if they exist: Prometheus' and Loki's.
METRICS, LOGS = "prometheus", "loki"


def dashboards() -> dict[str, str]:
    """Return Grafana's dashboards: JSON text by file name."""
    return texts(".json")


def rules() -> dict[str, str]:
    """Return Prometheus' rule files, recording rules and alerts: YAML text by file name."""
    return texts(".yaml")


def texts(suffix: str) -> dict[str, str]:
    """Return the files with a suffix, by name and in its order."""
    found = list(files(__name__).joinpath("files").iterdir())
    chosen = sorted((file for file in found if file.name.endswith(suffix)), key=lambda f: f.name)
    return {file.name: file.read_text(encoding="utf-8") for file in chosen}
