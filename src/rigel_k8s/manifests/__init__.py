"""Options of an orchestration job to Kubernetes objects; pure: plain data in, plain data out."""
