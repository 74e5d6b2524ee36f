"""What is wrong with an application's options, as problems with their paths; pure.

`application` checks everything, with one module for each part. The checks of `security` and
`network_policy` are in their modules.
"""
