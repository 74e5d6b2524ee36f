"""What applications and commands share with the stack (rigel_stack) of logs and metrics.

`options` and `checks` are the key `observability`, `names` the names that both use, `lines` the
forms of log lines. `exporter` is in an application's own release. `reading/` asks a Loki and a
Prometheus.
"""
