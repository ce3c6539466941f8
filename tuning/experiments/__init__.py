"""The paper's three experiments, from our own records: what they show and what they cannot is in docs/paper.md."""
