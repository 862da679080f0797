"""Tables of Markdown."""

from collections.abc import Iterable, Sequence


def markdown_rows(rows: Iterable[Sequence[str]]) -> str:
    """Rows of cells between bars, a line each."""
    return "".join(f"| {' | '.join(row)} |\n" for row in rows)


def markdown_table(header: Sequence[str], rows: Iterable[Sequence[str]], n_left: int = 1) -> str:
    """A table whose first `n_left` columns are flush left and the others flush right."""
    rule = ["---"] * n_left + ["---:"] * (len(header) - n_left)
    return markdown_rows([header, rule, *rows])
