"""What a deploy of an application asks of the cluster and the registries."""
