"""Job types, providers, and the runner of sequences; independent of what a job does.

`job` and `deploying` say what a job type may do, `registry` and `names` find them. `runner`
prepares a run: `steps` and `matrix` are what a sequence will do, `values` what its jobs get.
`live` watches a run from the main thread; `execution` carries it out in `branches`, each of which
can be stopped. `types/` has one module for each of our own.
"""
