"""Finds the stack on a cluster and reads from it: Loki, Prometheus, local ports, status."""
