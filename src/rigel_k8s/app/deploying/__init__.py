"""What a deploy of an application needs from the cluster and the registries."""
