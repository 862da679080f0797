"""Count the named numbers of the product, and those of them that are guesses.

A named number is a constant of a module (upper case) whose value holds a number of its own. A guess
says so in its comment. No number is to stand without a key of the schema, a citation, or an
ablation; `tests/test_house.py` holds both counts, which only fall. Prints a table by room. Example:

    python scripts/lab/count_numbers.py
"""

import ast
from collections import Counter
from pathlib import Path

PACKAGE = Path(__file__).resolve().parents[1] / "cherrypicker"


def named_numbers(source):
    """Each name of a module's numbers, whether its comment says guess, and the statement."""
    lines = source.splitlines()
    for statement in ast.parse(source).body:
        if isinstance(statement, ast.AnnAssign):
            targets = [statement.target]
        elif isinstance(statement, ast.Assign):
            targets = statement.targets
        else:
            continue
        if statement.value is None or not _has_number(statement.value):
            continue
        names = [
            name.id
            for target in targets
            for name in ast.walk(target)
            if isinstance(name, ast.Name) and name.id.isupper()
        ]
        first = statement.lineno - 1
        while first and lines[first - 1].startswith("#"):
            first -= 1
        text = "\n".join(lines[first : statement.end_lineno])
        for name in names:
            yield name, "guess" in text.lower(), statement


def _has_number(value):
    return any(
        isinstance(node, ast.Constant) and type(node.value) in (int, float)
        for node in ast.walk(value)
    )


def count(package=PACKAGE):
    """Numbers by room, and guesses by room."""
    numbers, guesses = Counter(), Counter()
    for path in sorted(package.rglob("*.py")):
        room = path.relative_to(package).parts[0].removesuffix(".py")
        for _, is_guess, _ in named_numbers(path.read_text(encoding="utf-8")):
            numbers[room] += 1
            guesses[room] += is_guess
    return numbers, guesses


def main():
    numbers, guesses = count()
    for room, n in numbers.most_common():
        print(f"{room:14s} {n:4d} {guesses[room]:4d} guesses")
    print(f"{'all':14s} {numbers.total():4d} {guesses.total():4d} guesses")


if __name__ == "__main__":
    main()
