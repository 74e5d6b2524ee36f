"""What is wrong with an application's options, as problems with their paths; pure.

`application` checks everything: a job's own options there, then `network`, `nodes`, `commands`
(what containers run) and `patches`. An option with a page of its own has its checks there:
`security`, `network_policy`, `components`, `lifecycle`; a generation has its own as well.
"""
