"""Logs, metrics and dashboards as a release of their own: options to objects, pure.

A job's `options` are a request, which `desired` merges with those of other jobs; `manifests/` makes
objects of the result, `boards/` has dashboards, rules and alerts. `install` is a job's part with
its hooks, `removal` the way back. `exporter` is in an application's own release. `reading/` asks
what runs.
"""
