"""The table in the documentation names tests that exist."""

import re


def test_every_test_of_the_table_exists(project):
    table = (project / "docs/reliability.md").read_text(encoding="utf-8")
    code = {path.stem: path.read_text() for path in (project / "tests").rglob("test_*.py")}
    functions = re.findall(r"^def (test_\w+)", "\n".join(code.values()), flags=re.M)
    named = set(re.findall(r"test_\w+", table))
    assert len(named) > 60
    unknown = {
        name
        for name in named
        if name not in code and not any(function.startswith(name) for function in functions)
    }
    assert unknown == set()
    for module in re.findall(r"`(test_reliability_\w+)", table):
        assert module in code


def test_every_case_of_the_table_exists(project):
    table = (project / "docs/reliability.md").read_text(encoding="utf-8")
    code = "".join(path.read_text() for path in (project / "tests").rglob("*.py"))
    for case in re.findall(r"\[([a-z_0-9]+)\]", table):
        assert f'"{case}"' in code, case
