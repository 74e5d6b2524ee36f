"""Logs, metrics and dashboards as a release of their own: options to objects, pure."""
