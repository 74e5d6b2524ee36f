"""Whether what was applied becomes ready, and if not, why.

`wait` waits, with what `view` sees: `standing` is how far each workload is, by its `readiness`, its
`causes` and its `crashes`; `account` is what is reported, and given up by `patience`.
"""
