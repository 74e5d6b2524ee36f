"""Dockerfile texts, docker and podman, registries; nothing here knows Kubernetes."""
