"""What is read of a photo is the same in each test of a module."""

import pytest

from cherrypicker.markers import detection


@pytest.fixture(scope="module")
def read_once():
    """What is read of a photo, and fitted to it, is so once where there is one camera.

    Returns
    -------
    dict
        What is known; cleared, all is read again.
    """
    find, fit, known = detection.find_markers, detection.fit_marker, {}

    def found(grey, dictionaries):
        key = (grey.tobytes(), *dictionaries)
        if key not in known:
            known[key] = find(grey, dictionaries)
        return known[key]

    def fitted(grey, corners, pattern, undistorted_px):
        key = grey.tobytes(), corners.tobytes(), pattern.tobytes()
        if key not in known:
            known[key] = fit(grey, corners, pattern, undistorted_px)
        return known[key]

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(detection, "find_markers", found)
        patch.setattr(detection, "fit_marker", fitted)
        yield known
