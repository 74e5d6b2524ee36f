"""The vocabulary of Kubernetes objects: names, labels, values, pod and workload frames; pure."""
