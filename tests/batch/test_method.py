"""One word chooses the method; keys of the last release, and keys that nothing reads, are told."""

import pytest
from workspace import PROJECT

from cherrypicker.batch.config import config_notes, resolve_config
from cherrypicker.batch.old_keys import GONE
from cherrypicker.files import load_yaml

SCHEMA = load_yaml(PROJECT / "workflow/schemas/config.schema.yaml")


def notes(**config):
    return config_notes(SCHEMA, config)


def keys_of_the_paper():
    """Every key whose default the method changes, and its value there."""
    for name, section in SCHEMA["properties"].items():
        for key, each in section.get("properties", {}).items():
            if "paper" in each:
                yield name, key, each


@pytest.mark.parametrize("section, key, each", list(keys_of_the_paper()))
def test_the_method_sets_what_no_key_sets(section, key, each):
    plain, paper = resolve_config(SCHEMA, {}), resolve_config(SCHEMA, {"method": "paper"})
    assert plain[section][key] == each["default"] != each["paper"] == paper[section][key]
    alone = resolve_config(SCHEMA, {section: {key: each["paper"]}})
    assert alone[section].pop(key) == each["paper"] and plain[section].pop(key) == each["default"]
    assert alone == plain, "a deviation can be taken alone"
    kept = resolve_config(SCHEMA, {"method": "paper", section: {key: each["default"]}})
    assert kept[section][key] == each["default"], "a key that is set wins over the method"


@pytest.mark.parametrize(
    "old, method",
    [
        ({"contract": {"method": "lbc"}}, "lbc"),
        ({"contract": {"method": "slbc"}}, "slbc"),
        ({"contract": {"preset": "paper"}}, "slbc"),
        ({"contract": {"preset": "paper", "method": "lbc"}}, "lbc"),
        ({"contract": {"preset": "default", "method": "lbc"}}, "limbs"),
        ({"graph": {"method": "mst"}}, "slbc"),
        ({"graph": {"method": "tree"}, "contract": {"method": "slbc"}}, "limbs"),
    ],
)
def test_keys_of_the_last_release_stand_for_the_new_one(old, method):
    assert resolve_config(SCHEMA, old)["skeleton"]["method"] == method
    (note,) = config_notes(SCHEMA, old)
    assert f"is now skeleton.method: {method}; the old key goes" in note
    for section, keys in old.items():
        assert all(f"{section}.{key}: {value}" in note for key, value in keys.items())


def test_moved_constants_are_taken_and_the_new_key_wins():
    old = {"contract": {"method": "slbc", "weights": {"trunk": "4"}, "max_iterations": None}}
    found = resolve_config(SCHEMA, old)
    assert found["skeleton"]["weights"]["trunk"] == 4 and "weights" not in found["contract"]
    assert found["skeleton"]["max_iterations"] == 20
    assert "contract.weights is now skeleton.weights" in config_notes(SCHEMA, old)[1]
    both = {"contract": {"method": "lbc"}, "skeleton": {"method": "limbs"}}
    assert resolve_config(SCHEMA, both)["skeleton"]["method"] == "limbs"
    assert (
        "contract.method: lbc does nothing beside skeleton.method" in config_notes(SCHEMA, both)[0]
    )


@pytest.mark.parametrize("key", GONE)
def test_a_key_that_is_gone_is_told_and_ends_no_run(key):
    section, name = key.split(".")
    assert name not in SCHEMA["properties"].get(section, {}).get("properties", {})
    (note,) = notes(**{section: {name: 3}})
    assert note.startswith(f"{key} does nothing any more: {GONE[key]}; ")
    assert resolve_config(SCHEMA, {section: {name: 3}}) == resolve_config(SCHEMA, {})


def test_a_key_that_nothing_reads_is_told_with_its_value_and_why():
    (note,) = notes(skeleton={"weights": {"trunk": 4}})
    assert note == (
        "skeleton.weights: {'trunk': 4} does nothing: it is read under skeleton.method: slbc, and "
        "that is limbs"
    )
    assert notes(skeleton={"method": "slbc", "weights": {"trunk": 4}}) == []
    assert notes(method="paper", skeleton={"weights": {"trunk": 4}}) == []
    assert len(notes(method="paper", skeleton={"weights": {"trunk": 4}, "method": "lbc"})) == 1


def keys_with_needs():
    """Every key that is read only under some values of another, set to what is not its default."""
    for section, keys in SCHEMA["properties"].items():
        for key, each in keys.get("properties", {}).items():
            for other, values in each.get("needs", {}).items():
                place, name = other.split(".")
                known = SCHEMA["properties"][place]["properties"][name].get("enum", [True, False])
                assert set(values) < set(known), other
                (in_vain, *_) = [value for value in known if value not in values]
                default = each["default"] or 3
                value = (
                    "cao"
                    if "enum" in each
                    else {"trunk": 3}
                    if isinstance(default, dict)
                    else default
                )
                value = value + 1 if isinstance(value, int) else value
                value = value * 0.9 if isinstance(value, float) else value
                yield {section: {key: value}}, place, name, in_vain, values[0]


@pytest.mark.parametrize("said, place, name, in_vain, read", list(keys_with_needs()))
def test_each_key_that_needs_another_is_told_and_else_not(said, place, name, in_vain, read):
    ((section, keys),) = said.items()
    for value, n_notes in ((in_vain, 1), (read, 0)):
        config = {section: dict(keys), place: {name: value}}
        if section == place:
            config = {section: {**keys, name: value}}
        found = [
            note for note in notes(**config) if note.startswith(f"{section}.{next(iter(keys))}:")
        ]
        assert len(found) == n_notes, found


def test_a_key_at_its_default_and_the_shipped_config_have_nothing_to_be_told():
    assert notes(skeleton={"weights": {"trunk": 10}, "max_iterations": 20}) == []
