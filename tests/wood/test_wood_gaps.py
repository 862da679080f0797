from cherrypicker.batch.config import lookup, resolve_config
from cherrypicker.files import load_schema
from cherrypicker.wood.gaps import GAP_M, STEM_GAP_M


def test_the_gaps_of_the_config_default_to_the_librarys(project):
    settings = resolve_config(load_schema(project / "workflow/schemas/config.schema.yaml"))
    assert lookup(settings, "contract.gap_m") == GAP_M
    assert lookup(settings, "contract.stem_gap_m") == STEM_GAP_M
