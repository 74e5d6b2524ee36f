"""Job types, providers, and the runner of sequences; independent of what a job does.

`job` and `deploying` say what a job type may do, `registry` and `names` find them. `runner`
prepares a run: `steps` and `matrix` are what a sequence will do, `values` what its jobs get.
`engine` runs that; `stopping` is what ends it early. `types/` has one module for each of our own.
"""
