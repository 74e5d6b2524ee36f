"""Releases on a cluster: what deploy.py does, step by step; independent of ROS and Rigelfiles.

`types` and `part` are the values. Look: `survey` reads what is there, `refusals/` what would be
refused, `plan` compares, `look` does it for a part. Write: `locking` holds the Lease, `pulling`
pulls images first, `apply` writes, `rollout/` waits, `record` and `revisions` keep what was done.
Beside a deploy: `rollback`, `removal`, `development` (and restarts), `status`, `listing`,
`history`, `difference`, `hiding`. What is ours is in `labelling` and `drift`.
"""
