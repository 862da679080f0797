"""The error a user can act on."""

from __future__ import annotations

import os


class StageError(Exception):
    """Bad input or an impossible request, told in the user's terms.

    The stage runner adds the tree and the rule, prints one line and exits with 1.

    Parameters
    ----------
    cause : str
        What is wrong, with the offending value, in one sentence.
    file : path-like, optional
        The file at fault.
    key : str, optional
        The config key(s) or the ``config/trees.tsv`` column to change.
    """

    def __init__(
        self, cause: str, *, file: str | os.PathLike | None = None, key: str | None = None
    ) -> None:
        self.cause = " ".join(str(cause).split())
        self.file = None if file is None else os.fspath(file)
        self.key = key
        super().__init__(self.describe())

    def describe(self) -> str:
        """Return cause, file and key as one line."""
        parts = [self.cause.rstrip(".")]
        if self.file is not None:
            parts.append(f"file: {self.file}")
        if self.key is not None:
            parts.append(f"change: {self.key}")
        return "; ".join(parts)

    def __reduce__(self) -> tuple:
        return _rebuild, (self.cause, self.file, self.key)


def _rebuild(cause: str, file: str | os.PathLike | None, key: str | None) -> StageError:
    return StageError(cause, file=file, key=key)
