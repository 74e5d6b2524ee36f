"""Image registries: their digests, and who may log in; independent of Kubernetes."""
