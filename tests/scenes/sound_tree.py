"""What the warnings read of a tree that is measured well, and what they say of one that is not."""

from types import SimpleNamespace

import numpy as np

from cherrypicker.traits.flags import quality_flags
from cherrypicker.traits.foot import Foot
from cherrypicker.traits.intervals import Estimate
from cherrypicker.traits.measure import TraitOptions
from cherrypicker.traits.trunk import TrunkDiameter

_ZERO = np.zeros(3)
SOUND = {
    "unit": "m",
    "options": TraitOptions(),
    "height": Estimate(2.5),
    "trunk": TrunkDiameter(0.30, 0.06, _ZERO, np.eye(3)[2], {}, arc_deg=360.0),
    "unmeasured": [],
    "foot": Foot(_ZERO, "ground", 0.0, 0.0),
    "support": SimpleNamespace(gaps=np.zeros(0), n_stray=0, missed_share=0.0, missed_length=0.0),
    "crown_width": Estimate(1.0),
    "confidence": None,
    "edges": (),
    "missing_top": None,
}


def flags_of(reports, **measured):
    """The warnings of a sound tree by its reports and by what was measured otherwise."""
    return quality_flags(reports, SimpleNamespace(**SOUND | measured))
