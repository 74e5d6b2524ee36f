"""Dockerfile texts, docker and podman, registries; independent of Kubernetes."""
