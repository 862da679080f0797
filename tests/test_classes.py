"""The one table of classes, and what has to agree with it."""

import numpy as np
import yaml

from cherrypicker.classes import CHANNELS, CLASS_IDS, WOOD, Label, wood_mask
from cherrypicker.report.style import CLASS_COLORS


def test_ids_are_what_the_files_have_said_so_far():
    assert {name: CLASS_IDS[name] for name in ("ground", "trunk", "branch", "unlabelled")} == {
        "ground": 0,
        "trunk": 1,
        "branch": 2,
        "unlabelled": 255,
    }
    assert Label.CALIBRATION_UNIT.title == "calibration unit"


def test_every_channel_of_the_network_gives_a_class():
    assert [label.channel for label in CHANNELS] == list(range(len(CHANNELS)))
    assert {label.channel for label in Label} - {None} == set(range(len(CHANNELS)))
    assert CHANNELS[Label.SUPPORT_POST.channel] is Label.SUPPORT_POST


def test_every_class_has_a_colour_of_its_own():
    assert CLASS_COLORS.keys() == set(Label)
    assert len(set(CLASS_COLORS.values())) == len(Label)


def test_wood_is_what_is_contracted(project):
    schema = yaml.safe_load((project / "workflow/schemas/config.schema.yaml").read_text())
    options = {name: schema["properties"][name]["properties"] for name in ("contract", "skeleton")}
    assert options["contract"]["classes"]["default"] == list(WOOD)
    assert options["skeleton"]["weights"]["propertyNames"]["enum"] == list(CLASS_IDS)
    labels = np.array(list(Label))
    assert labels[wood_mask(labels)].tolist() == [Label.TRUNK, Label.BRANCH]
