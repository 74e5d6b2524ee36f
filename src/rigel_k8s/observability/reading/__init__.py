"""How the stack on a cluster is found and asked: Loki, Prometheus, local ports, status."""
