"""Comparison of configurations over many scans: planned as cells, measured in the runtime, kept in one file.

`plan` says what the cells are, `measuring` how one is measured, `local` and `cluster` where, `ledger` keeps what was
found, `batch` puts these together, `ranking` and `export` read the result. docs/compare.md is the user's page.
"""
