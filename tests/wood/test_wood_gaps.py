from cherrypicker.batch.config import lookup, resolve_config
from cherrypicker.files import load_yaml
from cherrypicker.wood.thinned import GrowthOptions


def test_the_gaps_of_the_config_default_to_the_librarys(project):
    settings = resolve_config(load_yaml(project / "workflow/schemas/config.schema.yaml"))
    assert lookup(settings, "contract.gap_m") == GrowthOptions.gap_m
    assert lookup(settings, "contract.stem_gap_m") == GrowthOptions.stem_gap_m
