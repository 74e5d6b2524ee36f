"""Whether what was applied becomes ready, and if not, why.

`wait` looks again and again: `view` is what it sees, `standing` how far each workload is, by its
`readiness`. `causes` explain what is not ready; `account` reports, and gives up by `patience`.
"""
