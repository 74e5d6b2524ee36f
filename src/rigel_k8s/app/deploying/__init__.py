"""What a deploy of an application needs of the cluster, of registries and of local files.

`prepare` makes a release of options: `target` names it, `localfiles` and `parameterfiles` read what
is beside the Rigelfile, `images` finds digests and credentials. `part` has the hooks around its
deploy, and `results` copies files out of a pod at the end.
"""
