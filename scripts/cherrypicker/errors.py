"""The error a user can act on."""

import os
from functools import partial

# Characters of a cause: a spoilt file's own text would fill the console
LONGEST_CAUSE = 1000


class StageError(Exception):
    """Bad input or an impossible request, told in the user's terms.

    The stage runner adds the tree and the rule, prints one line and exits with 1.

    Parameters
    ----------
    cause : str
        What is wrong, with the offending value, in one sentence; cut where it is very long, and
        what a terminal would obey is shown as its code.
    file : path-like, optional
        The file at fault.
    key : str, optional
        The config key(s) or the ``config/trees.tsv`` column to change.
    """

    def __init__(
        self, cause: str, *, file: str | os.PathLike | None = None, key: str | None = None
    ) -> None:
        self.cause = _on_a_line(" ".join(str(cause).split()))
        self.file = None if file is None else os.fspath(file)
        self.key = None if key is None else _on_a_line(key)
        super().__init__(self.describe())

    def arguments(self) -> dict[str, str | None]:
        """Return cause, file and key by name: what another of the same is made of."""
        return {"cause": self.cause, "file": self.file, "key": self.key}

    def describe(self) -> str:
        """Return cause, file and key as one line."""
        parts = [self.cause.rstrip(".")]
        if self.file is not None:
            parts.append(f"file: {_on_a_line(self.file)}")
        if self.key is not None:
            parts.append(f"change: {self.key}")
        return "; ".join(parts)

    def __reduce__(self) -> tuple:
        return partial(StageError, self.cause, file=self.file, key=self.key), ()


def _on_a_line(text: str) -> str:
    """Return a text that can be shown, cut in its middle where it is very long."""
    if len(text) > LONGEST_CAUSE:
        half = LONGEST_CAUSE // 2 - 3
        text = f"{text[:half]} [...] {text[-half:]}"
    return "".join(one if one.isprintable() else repr(one)[1:-1] for one in text)
