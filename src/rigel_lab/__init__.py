"""For machines without a cluster or an image registry: a local Kubernetes, and ROS base images."""
