"""A tree's hand measurements, each beside what we measured there."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from cherrypicker.accuracy.measures import Measure
from cherrypicker.accuracy.places import TOLERANCE_M, Place, Places
from cherrypicker.files import rounded
from cherrypicker.geometry.error_terms import Terms
from cherrypicker.skeleton import Skeleton, axes
from cherrypicker.skeleton.axis_radii import typical_scatter
from cherrypicker.traits.intervals import diameter_terms, interval
from cherrypicker.traits.photo_diameters import with_photos
from cherrypicker.traits.reports import Reports
from cherrypicker.traits.table import ends_of

# A trunk diameter was measured at the height of a section if it lies this close, m
_SAME_HEIGHT_M = 0.005
# A value is told as one of another unit, or as a girth, where it would be off by less than a fifth
# there (guess): no two units are as near to one another
_CLOSE = 0.2
_NUMBERS = ("ours", "low", "high")


class ComparedTree:
    """What a tree's own files say, for its hand measurements.

    ``traits.json``, the rows of ``branches.csv``, the skeleton that both were measured on and, of
    a scan from photos, ``scale.json`` and ``photo_check.json``.
    """

    def __init__(
        self,
        traits: Mapping,
        branches: Sequence[Mapping],
        skeleton: Skeleton,
        *,
        scale: Mapping | None = None,
        photo_check: Mapping | None = None,
    ) -> None:
        self.traits, self.branches = traits, branches
        self.typical = typical_scatter(skeleton)
        self.scale_error = Reports(scale=scale or {}).scale_error
        axis_list, seen = axes(skeleton), (photo_check or {}).get("branches", ())
        self.skeleton = with_photos(skeleton, axis_list, seen, self.scale_error)
        self.places = Places(self.skeleton, axis_list, traits["foot"][2])

    def pair(self, measure: Measure) -> dict:
        """Return one hand measurement beside ours.

        It has ``trait``, ``unit``, ``hand``, ``given``, ``who``, ``note``, ``line``, ``place`` (in
        words) and what `_ours` found: ``ours``, ``low`` and ``high`` (its 90 % interval) or None,
        ``branch_id`` or None; ``problem`` where there is none of ours, ``doubts``.
        """
        quantity = measure.quantity
        found: dict[str, Any] = dict.fromkeys((*_NUMBERS, "branch_id"))
        found |= {"problem": "", "doubts": []} | self._ours(measure)
        found |= {name: rounded(found[name]) for name in _NUMBERS if found[name] is not None}
        found["doubts"] = [*found["doubts"], *_unit_doubts(measure, found["ours"])]
        return {
            "trait": quantity.name,
            "unit": quantity.unit,
            "hand": rounded(measure.value),
            "given": measure.given,
            "who": measure.who,
            "note": measure.note,
            "line": measure.line,
            "place": _place_text(measure),
            **found,
        }

    def _ours(self, measure: Measure) -> dict:
        quantity = measure.quantity
        if self.skeleton.unit != "m" and quantity.unit not in ("1", "deg"):
            return {"problem": "the scan has no scale"}
        if quantity.is_on_branch:
            return self._on_branch(measure)
        if quantity.name == "trunk_diameter_m" and "height_m" in measure.place:
            return self._trunk_at(measure.place["height_m"])
        return self._trait(quantity.name)

    def _trait(self, name: str) -> dict:
        value = self.traits.get(name)
        if value is None:
            return {"problem": "this tree has no such trait"}
        low, high = self.traits.get(f"{name}_ci90") or (None, None)
        return {"ours": value, "low": low, "high": high}

    def _trunk_at(self, height: float) -> dict:
        """The section at that height where one was measured, else the skeleton's trunk there."""
        if abs(height - self.traits["trunk_height_m"]) <= _SAME_HEIGHT_M:
            return self._trait("trunk_diameter_m")
        for at, value in self.traits.get("trunk_diameters", {}).items():
            if abs(height - float(at)) <= _SAME_HEIGHT_M:
                error = self.traits.get("trunk_diameters_se", {}).get(at)
                low, high = interval(value, {"fit": error}) if error else (None, None)
                return {"ours": value, "low": low, "high": high}
        place = self.places.on_trunk(height)
        if place is None:
            return {"problem": f"the trunk ends below {height:g} m"}
        return self._diameter(place)

    def _on_branch(self, measure: Measure) -> dict:
        quantity, at, order = measure.quantity, measure.place, measure.order
        if measure.point is not None:
            place = self.places.at_point(np.array(measure.point), order)
        else:
            far = at.get("distance_m")
            place = self.places.towards(at["height_m"], at["azimuth_deg"], far, order)
        if place is None:
            return {"problem": f"no branch within {100 * TOLERANCE_M:.0f} cm of the place"}
        doubts = []
        if place.rivals:
            others = ", ".join(map(str, place.rivals))
            doubts.append(f"it may be on branch {others} as well; give distance_m, or a point")
        if quantity.at_place:
            if place.stretch > 2 * TOLERANCE_M:  # it is told to the tolerance, on either side
                doubts.append("the branch runs along that azimuth; give distance_m, or a point")
            return self._diameter(place) | {"doubts": doubts}
        row = self.branches[place.branch]
        low, high = map(row.get, ends_of(quantity.column))
        found = {"ours": row[quantity.column], "low": low, "high": high}
        return found | {"branch_id": place.branch, "doubts": doubts}

    def _diameter(self, place: Place) -> dict:
        """The skeleton's diameter at a place, by points and photos, with its 90 % interval."""
        value, fields, node = place.diameter, self.skeleton.fields, place.node
        found = {"ours": value, "branch_id": place.branch}
        terms: Terms = {"fit": fields["photo_error"][node]}
        if np.isnan(terms["fit"]):
            if self.typical is None:
                return found
            scatter = fields["residual"][node] or self.typical
            terms = diameter_terms(value, fields["radius_error"][node], scatter, self.scale_error)
        low, high = interval(value, terms)
        return found | {"low": low, "high": high}


def _unit_doubts(measure: Measure, ours: float | None) -> list[str]:
    """What else a value would fit: another unit, or a girth."""
    if not ours:
        return []
    units = measure.quantity.units
    fits = [
        unit
        for unit, factor in units.items()
        if factor != units[measure.unit] and abs(measure.number * factor / ours - 1.0) < _CLOSE
    ]
    doubts = [f"{measure.given} would fit in {unit}: check the unit" for unit in fits]
    if "diameter" in measure.quantity.name and abs(measure.value / np.pi / ours - 1.0) < _CLOSE:
        doubts.append(f"{measure.given} would fit as a girth: divide it by pi")
    return doubts


def _place_text(measure: Measure) -> str:
    place = measure.place
    if measure.point is not None:
        return "at ({:.2f}, {:.2f}, {:.2f})".format(*measure.point)
    parts = [f"{place['height_m']:g} m high"] if "height_m" in place else []
    parts += [f"towards {place['azimuth_deg']:g}°"] if "azimuth_deg" in place else []
    parts += [f"{place['distance_m']:g} m out"] if "distance_m" in place else []
    parts += [f"order {measure.order}"] if measure.order is not None else []
    return ", ".join(parts)
