from cherrypicker.batch.config import load_schema, lookup, resolve_config
from cherrypicker.wood.gaps import GAP_M, STEM_GAP_M


def test_the_gaps_of_the_config_default_to_the_librarys(project):
    settings = resolve_config(load_schema(project / "workflow/schemas/config.schema.yaml"))
    for key in ("contract.gap_m", "segment.trunk_gap_m"):
        assert lookup(settings, key) == GAP_M
    for key in ("contract.stem_gap_m", "segment.stem_gap_m"):
        assert lookup(settings, key) == STEM_GAP_M
