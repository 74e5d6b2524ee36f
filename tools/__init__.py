"""Programs for those who change rigel-k8s; no part of what is installed."""
