"""What to do about each quality warning."""

from __future__ import annotations

#: Warning (the word before its colon) to what helps; in the order of `cherrypicker.traits.flags`.
ADVICE = {
    "trunk_not_measured": "Look at the trunk sections below. Photograph the stem from all sides, "
    "or set traits.trunk_height_m where it is seen whole.",
    "arc_coverage_low": "Photograph the stem from the sides that lack, or set "
    "traits.trunk_height_m where it is seen whole.",
    "trunk_rough": "Look at the trunk sections: a fork, a burr or a tie there? Set "
    "traits.trunk_height_m above or below it.",
    "trunk_height_moved": "Set traits.trunk_height_m to a height that the trunk reaches.",
    "no_diameter": "Take these heights out of traits.trunk_heights_m, or photograph the stem "
    "there.",
    "no_ground": "Photograph the ground around the stem. Until then all heights lack what is "
    "below the lowest point.",
    "foot_unseen": "Photograph the foot of the stem. Look whether the skeleton's root is the "
    "tree's.",
    "foot_hidden": "Clear the grass from the foot and photograph it, or trust heights less.",
    "gaps_bridged": "Sort the branches by their flags and look at those with a gap. Cut what is "
    "not one branch; photograph that side from nearer.",
    "stray_pieces": "In the view, connect the pieces that are the tree's and delete the others.",
    "wood_left_out": "In the view, look for wood without a line. Is it the tree's? Then "
    "photograph it from nearer. Is it not? Then crop closer.",
    "wood_loose": "In the view, look for wood beside the skeleton. Is it the tree's? Then raise "
    "contract.gap_m over its distance, or photograph what lies between from nearer.",
    "no_crown": "Is this the tree? Set crop.target_xy to its place, or look at the classes.",
    "labels_uncertain": "Colour the points by confidence in the view, and correct by editing what "
    "follows from a wrong class.",
    "unscaled": "Put a marker beside the tree and name it in marker_sides_m, or give a scale.",
    "odd_height": "Check scale, marker_sides_m or cloud_unit in trees.tsv.",
    "scale_uncertain": "Photograph the markers from nearer and from more sides, or use larger "
    "ones.",
    "scale_doubtful": "Compare the known lengths below: measure again the one that is named, and "
    "look for it in the photos.",
    "few_photos": "See below which photos failed and why. Take more, with more overlap.",
    "cameras_uncertain": "Take the photos closer together, so that each part stands in more.",
    "top_outside_photos": "Photograph the tree from farther away, with its top in the picture.",
    "side_outside_photos": "Photograph the tree from farther away, with that side in the picture.",
    "top_not_in_cloud": "Raise mvs.max_image_size_px, and look at the depth maps below.",
    "dropped_by_photos": "Look at the worst photo below: what is purple was dropped. Nothing is to "
    "do if it is no wood.",
    "not_in_photos": "Look at the worst photo below, and delete in the view what is red there.",
    "wood_missing": "Look at the worst photo below: what is orange lacks. Photograph again "
    "where the table below says, or raise mvs.max_image_size_px.",
    "target_close": "Look whether the right tree was taken; else set crop.target_xy to the other.",
    "target_far": "Correct crop.target_xy: the places of the candidates stand below.",
    "second_tree": "Look whether the right tree was taken; else set crop.target_xy.",
    "edits_lost": "Look whether these corrections are still needed. If so, make them again in the "
    "view; take the lost ones out of the file.",
}
ANY = "Look at the stage that says so, below."


def advice_for(warning: str) -> str:
    """What to do about a warning "name: sentence", or about one without a name."""
    return ADVICE.get(warning.partition(":")[0], ANY)
