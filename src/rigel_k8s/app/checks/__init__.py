"""What is wrong with an application's options, as problems with their paths; pure.

`application` checks everything: a job's own options there, then `network`, `nodes`, `commands`
(what containers run) and `patches`. A new check of a job is called in `application.check`, one of
a node in `nodes.check_node`. An option with a page of its own has its checks there:
`security`, `network_policy`, `components`, `lifecycle`; a generation has its own as well.
"""
