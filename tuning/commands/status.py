"""Exit statuses of the `hapticlod` command."""

DONE, FAILED, BAD_INPUT, PARTIAL, INTERRUPTED, TERMINATED = 0, 1, 2, 3, 130, 143
