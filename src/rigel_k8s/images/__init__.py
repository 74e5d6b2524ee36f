"""Dockerfile texts, docker and podman, registries; independent of Kubernetes.

`dockerfile` writes a Dockerfile. `tools` chooses an `engine`, `docker` or `podman`, whose output
`progress` shows. `registry` asks registries for digests, with `credentials`.
"""
