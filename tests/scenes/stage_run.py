"""A stage's script, run in this process as its rule runs it."""

import importlib

from workspace import PROJECT

from cherrypicker.batch.config import lookup, resolve_config
from cherrypicker.files import load_yaml
from cherrypicker.runner import _bundled, keys_of_stage, options_of

SCHEMA = load_yaml(PROJECT / "workflow/schemas/config.schema.yaml")


def run_stage(stage, settings=None, **values):
    """Run a stage with its keys from the config, by default the shipped one, and what is given."""
    main = importlib.import_module(stage).main
    settings = resolve_config(SCHEMA, {}) if settings is None else settings
    options = {name: option.default for name, option in options_of(main).items()}
    for key in keys_of_stage(SCHEMA, stage):
        options[key.rpartition(".")[2]] = lookup(settings, key)
    main(**_bundled(main, {**options, **values}))
