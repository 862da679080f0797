"""What is wrong with a tree's photos, and what to photograph again."""

from collections import Counter
from collections.abc import Collection, Sequence
from dataclasses import dataclass, field

import numpy as np

from cherrypicker.capture.look import Look
from cherrypicker.capture.overlap import find_overlaps
from cherrypicker.capture.ring import LEAST_SURE, Ring, find_ring, widest_gaps
from cherrypicker.markers.scan import Scan
from cherrypicker.photos import MIN_PHOTOS
from cherrypicker.sfm.photo_files import copies

# Photos shall stand 15 to 20 degrees apart (README); the azimuths are right within 5 (measured)
WIDE_GAP_DEG = 25.0
# More blur than the set's median, or in all, that 5 and 9 px of motion make (measured on four sets)
MORE_BLUR, MOST_BLUR = 0.12, 0.40
MOST_STOPS = 1.0  # from the set's median: good photos of six sets have 0.8, with half two are told
MOST_CLIPPED = 0.35  # share of burnt or of black pixels (guess)
_MOST_NAMES = 4


@dataclass
class Finding:
    """Something to know of the photos."""

    text: str  # what, and what to do
    photos: list[int] = field(default_factory=list)  # which, as places in the list
    is_stop: bool = False  # whether to photograph again; else it is to know


@dataclass
class Verdict:
    """The findings on a tree's photos."""

    looks: list[Look]
    ring: Ring  # of all photos; unreadable ones belong to no group of more than one
    findings: list[Finding]  # reasons to photograph again first
    gaps: list[tuple[float, float]]  # first and last azimuth of each wide gap, degrees

    @property
    def is_go(self) -> bool:
        """Whether nothing is to be photographed again."""
        return not any(finding.is_stop for finding in self.findings)


def judge(looks: Sequence[Look], marker_ids: Collection[int], threads: int) -> Verdict:
    """Judge a tree's photos, whose scale is to come from the markers of these ids.

    So many threads match a pair of photos each.
    """
    looks = list(looks)
    ring = find_ring(len(looks), find_overlaps(looks, threads))
    good = [row for row, look in enumerate(looks) if not look.problem]
    blur = [looks[row].blur for row in good]
    most = min(float(np.median(blur)) + MORE_BLUR, MOST_BLUR) if good else MOST_BLUR
    blurred = [row for row in good if looks[row].blur > most]
    findings = [*_files(looks), *_exposure(looks, good), *_markers(looks, marker_ids)]
    if blurred:
        n_sharp = len(good) - len(blurred)
        text = f"blurred: {_names(looks, blurred)}; they count as missing"
        findings.append(Finding(text, blurred, n_sharp < MIN_PHOTOS))
    azimuth = ring.azimuth_deg.copy()
    azimuth[blurred] = np.nan
    around, gaps = _around(looks, ring, azimuth)
    findings += around
    findings.sort(key=lambda finding: not finding.is_stop)
    return Verdict(looks, ring, findings, gaps)


def _names(looks: Sequence[Look], rows: Sequence[int]) -> str:
    names = [looks[row].name for row in rows[:_MOST_NAMES]]
    more = len(rows) - len(names)
    return ", ".join(names) + (f" and {more} more" if more else "")


def _files(looks: Sequence[Look]) -> list[Finding]:
    """Unreadable photos, copies, too few, several cameras."""
    broken = [row for row, look in enumerate(looks) if look.problem]
    found = []
    if broken:
        text = f"{_names(looks, broken)}: {looks[broken[0]].problem}; copy again or delete"
        found.append(Finding(text, broken, True))
    same = copies(looks)
    if same:
        rows = [row for row, look in enumerate(looks) if look.name in same]
        found.append(Finding(f"copies of other photos: {_names(looks, rows)}", rows))
    n_good = len(looks) - len(broken) - len(same)
    if n_good < MIN_PHOTOS:
        found.append(Finding(f"{n_good} photos, {MIN_PHOTOS} are the least", [], True))
    kinds = Counter(
        (look.camera, round(look.focal_mm, 1), *sorted((look.width, look.height)))
        for look in looks
        if not look.problem
    )
    if len(kinds) > 1:
        usual = max(kinds, key=kinds.__getitem__)
        text = f"{len(kinds)} cameras, focal lengths or sizes, mostly {usual[0] or 'unnamed'} at "
        text += f"{usual[1]:g} mm, {usual[3]} x {usual[2]} px: no zooming, no cropping"
        found.append(Finding(text))
    return found


def _exposure(looks: Sequence[Look], good: Sequence[int]) -> list[Finding]:
    if not good:
        return []
    usual = float(np.median([looks[row].brightness for row in good]))
    uneven = [row for row in good if abs(looks[row].brightness - usual) > MOST_STOPS]
    burnt = [row for row in good if looks[row].burnt > MOST_CLIPPED]
    black = [row for row in good if looks[row].black > MOST_CLIPPED]
    said = (
        (uneven, "exposed otherwise than the rest, lock the exposure"),
        (burnt, "burnt out, twigs vanish before a white sky; expose less"),
        (black, "too dark; expose more"),
    )
    return [Finding(f"{text}: {_names(looks, rows)}", rows) for rows, text in said if rows]


def _markers(looks: Sequence[Look], marker_ids: Collection[int]) -> list[Finding]:
    """Markers that too few photos show; one that is seen well is enough."""
    if not marker_ids:
        return []
    seen = {one: sum(one in look.marker_ids for look in looks) for one in sorted(marker_ids)}
    told = ", ".join(f"marker {one} in {count} photos" for one, count in seen.items())
    if max(seen.values()) >= Scan.min_images:
        return []
    others = sorted({one for look in looks for one in look.marker_ids} - set(marker_ids))
    hint = f"; seen are {', '.join(map(str, others))}" if others else ""
    text = f"{told}{hint}: photograph it from two places, near and whole, or mend the table"
    return [Finding(text, [], True)]


def _around(
    looks: Sequence[Look], ring: Ring, azimuth: np.ndarray
) -> tuple[list[Finding], list[tuple[float, float]]]:
    """Gaps in the ring, and photos that hang on no others."""
    found, gaps = [], []
    apart = [row for row, look in enumerate(looks) if ring.group[row] and not look.problem]
    if apart:
        text = f"{len(apart)} photos overlap too little with the others"
        text += f" ({_names(looks, apart)}): photograph there again, 10 to 15 degrees apart"
        # Of fewer the azimuths of the others tell whether they leave a gap
        found.append(Finding(text, apart, len(apart) > (1 - LEAST_SURE) * len(looks)))
    for width, before, after in widest_gaps(azimuth, WIDE_GAP_DEG):
        pair = f"{looks[before].name} and {looks[after].name}"
        if ring.is_told:
            text = f"no sharp photo that overlaps for {width:.0f} degrees: "
            text += f"photograph between {pair}"
            gaps.append((float(azimuth[before]), float(azimuth[before] + width)))
        else:
            text = f"perhaps no sharp photo between {pair}: look there yourself"
        found.append(Finding(text, [before, after], ring.is_told))
    if not ring.is_told:
        n_sure = int(ring.is_sure.sum())
        text = f"cannot tell where the photos stand: their overlaps agree on {n_sure} of "
        found.append(Finding(text + f"{len(looks)}; take more, 10 to 15 degrees apart, to be sure"))
    return found, gaps
