"""Typed errors of the model: one clear message says where, what, and what to do."""

from __future__ import annotations


class HapticLODError(Exception):
    """Base of every error that HapticLOD raises on purpose."""


class InputError(HapticLODError):
    """Something the user gave cannot be used.

    Args:
        where: file, line, field or face index, as narrow as it is known.
        what: what is wrong there.
        remedy: what the user can do about it.

    `str(error)` is the single line `where: what; remedy`, which the command line prints before it exits with status 2.
    """

    def __init__(self, where: str, what: str, remedy: str) -> None:
        super().__init__(where, what, remedy)
        self.where = where
        self.what = what
        self.remedy = remedy

    def __str__(self) -> str:
        # File names and library messages may carry line breaks: the message stays one line.
        return " ".join(f"{self.where}: {self.what}; {self.remedy}".split())
