"""What a tree is pruned to: limits by name, from a preset and the config's own."""

from dataclasses import dataclass, field
from pathlib import Path

from cherrypicker.errors import StageError
from cherrypicker.files import load_yaml

#: Name of a limit to why a cut that serves it is made, as ``pruning.csv`` spells it, and its words
#: on pages. In turn: where wood may stand, which of it goes, how much may be left, what may touch.
TURNS = (
    {
        "height_m": ("over_height", "Height"),
        # Twice the farthest reach across the row
        "row_width_m": ("over_width", "Width across the row"),
    },
    {
        "renew_limbs": ("renewal", "Limbs to renew"),  # so many of the thickest limbs go
        "steep_deg": ("steep", "Steep limbs"),  # limbs go whose crotch angle is less
        "shaded_share": ("shaded", "Shaded limbs"),  # limbs go that get less of the sky's light
    },
    {
        "limb_trunk_ratio": ("over_ratio", "Limb-to-trunk ratio"),
        "n_limbs": ("too_many_limbs", "Limbs"),
        "length_m_per_cm2": ("too_much_wood", "Wood per cm² of the stem's section [m]"),
        "tips_per_cm2": ("too_many_tips", "Tips per cm² of the stem's section"),
        "shoots_per_cm2": ("too_many_shoots", "Shoots per cm² of the stem's section"),
        "bearing_length_m_per_cm2": (
            "too_much_bearing_wood",
            "Bearing wood per cm² of the stem's section [m]",
        ),
    },
    {"crossing": ("crossing", "Axes that touch")},  # so many pairs of axes that touch are let be
)
LIMIT_WORDS = {name: words for turn in TURNS for name, (_, words) in turn.items()}
SHARES = {"renew_share", "height_to_row_distance"}  # limits that become others
PRESETS_FILE = Path(__file__).with_name("presets.yaml")
OWN = "own"  # the preset that has no limits


@dataclass(frozen=True)
class PruningOptions:
    """Config keys that pruning reads, as the schema describes them."""

    preset: str | None = None
    target: dict[str, float] = field(default_factory=dict)
    keep: tuple[int, ...] = ()
    row_azimuth_deg: float = 0.0
    row_distance_m: float | None = None
    min_limb_m: float = 0.10


@dataclass(frozen=True)
class Target:
    """Limits that a tree is pruned to."""

    preset: str
    source: str
    limits: dict[str, float]  # by the names in `TURNS`
    stub: float  # that a thinning cut leaves beyond the bearer's surface
    notes: list[str]  # what was left out, and why


def read_presets() -> dict[str, dict]:
    """The shipped presets by name: ``source``, ``stub_m`` and ``target``."""
    return load_yaml(PRESETS_FILE)


def resolve_target(options: PruningOptions, n_limbs: int, unit: str) -> Target:
    """The limits of a preset with those of the config over them.

    Raises
    ------
    StageError
        If there is no limit, one of no known name, or one in metres of a tree without a scale.
    """
    presets = read_presets()
    if options.preset not in {OWN, *presets}:
        raise StageError(f"no preset {options.preset!r}", key="pruning.preset")
    preset = presets.get(options.preset, {"source": "config", "stub_m": 0.0, "target": {}})
    limits, notes = preset["target"] | options.target, []
    unknown = sorted(limits.keys() - LIMIT_WORDS.keys() - SHARES)
    if unknown or not limits:
        cause = f"no limit is named {', '.join(unknown)}" if unknown else "no limit is given"
        raise StageError(cause, key="pruning.target")
    if "renew_share" in limits:
        limits["renew_limbs"] = round(limits.pop("renew_share") * n_limbs)
    if "height_to_row_distance" in limits:
        share = limits.pop("height_to_row_distance")
        if options.row_distance_m:
            limits.setdefault("height_m", share * options.row_distance_m)
        else:
            notes.append(f"no height: {share:g} of traits.row_distance_m, which is not given")
    if unit != "m" and (metric := [n for n in limits if n.endswith("_m") or "_cm2" in n]):
        raise StageError(f"a limit of {metric[0]} needs a scale", key="scale.mode")
    return Target(options.preset or OWN, preset["source"], limits, preset["stub_m"], notes)
