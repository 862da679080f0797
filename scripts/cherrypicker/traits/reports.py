"""What the stages before the traits say of a scan."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from cherrypicker.mvs.scan_photos import ScanPhotos
    from cherrypicker.poses import Poses


@dataclass(frozen=True, kw_only=True)
class Reports:
    """Reports of earlier stages; empty or None for what a scan does not have."""

    scale: Mapping[str, Any] = field(default_factory=dict)  # ``scale.json``
    sparse: Mapping[str, Any] = field(default_factory=dict)  # ``sfm/report.json``
    target: Mapping[str, Any] = field(default_factory=dict)  # ``target.json``
    edits: Mapping[str, Any] = field(default_factory=dict)  # ``edits.json``
    photo_check: Mapping[str, Any] = field(default_factory=dict)  # ``photo_check.json``
    # Both in the cloud's frame and unit: where the photos, not the tree, end; and what they show
    poses: Poses | None = None
    photos: ScanPhotos | None = None

    @property
    def scale_error(self) -> float:
        """Relative standard error of the scale; 0 where it is not known."""
        return (self.scale.get("scale_std") or 0.0) / (self.scale.get("scale") or 1.0)
