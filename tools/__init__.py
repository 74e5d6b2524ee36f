"""Programs for developers of rigel-k8s; they are not installed."""
