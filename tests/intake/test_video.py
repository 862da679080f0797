"""Frames of a video: as far apart as asked, the sharpest of each place, and films that fail."""

import cv2
import numpy as np
import pytest
from sfm_scene import texture

from cherrypicker.batch.scans import sizes_of
from cherrypicker.errors import StageError
from cherrypicker.intake.prepare import PrepareOptions, prepare_photos, size_of_capture
from cherrypicker.intake.video import choose_frames, film_header

WIDTH, HEIGHT, PX_A_FRAME = 320, 240, 4
STEP = 0.1  # 32 px, eight frames


def film(path, frames):
    writer = cv2.VideoWriter(
        str(path), cv2.VideoWriter_fourcc(*"mp4v"), 10, (WIDTH, HEIGHT), isColor=True
    )
    for frame in frames:
        writer.write(np.ascontiguousarray(frame))
    writer.release()
    return path


def pan(n_frames, blurred=lambda i: False):
    """A camera that moves along a wall by so many pixels a frame."""
    wall = texture(np.random.default_rng(1), WIDTH + PX_A_FRAME * n_frames)
    for i in range(n_frames):
        frame = wall[:HEIGHT, PX_A_FRAME * i : PX_A_FRAME * i + WIDTH]
        yield cv2.blur(frame, (9, 1)) if blurred(i) else frame


def numbers(path, step=STEP):
    return np.array([frame.number for frame in choose_frames(path, step)])


def test_frames_lie_as_far_apart_as_asked_and_are_the_sharpest(tmp_path):
    path = film(tmp_path / "walk.mp4", pan(44, blurred=lambda i: i % 4 != 1))
    taken = numbers(path)
    apart = PX_A_FRAME * np.diff(taken) / WIDTH
    assert (apart <= 1.3 * STEP).all() and (apart >= 0.4 * STEP).all()
    assert (taken % 4 == 1).all()
    assert len(numbers(path, 2 * STEP)) < len(taken)


def test_who_stands_still_gives_one_photo(tmp_path):
    (frame,) = pan(1)
    still = film(tmp_path / "still.mp4", [frame] * 20 + list(pan(20))[1:])
    assert (numbers(still) < 20).sum() == 1


def test_a_cut_is_a_new_place_and_black_frames_are_none(tmp_path):
    rng = np.random.default_rng(2)
    black = np.zeros((HEIGHT, WIDTH, 3), np.uint8)
    one, two = texture(rng)[:HEIGHT, :WIDTH], texture(rng)[:HEIGHT, :WIDTH]
    path = film(tmp_path / "cut.mp4", [black] * 3 + [one] * 4 + [black] * 3 + [two] * 4)
    taken = numbers(path)
    assert len(taken) == 2 and 3 <= taken[0] < 7 and taken[1] >= 10


def prepared(tmp_path, path):
    return prepare_photos([path], tmp_path / "photos", tmp_path / "masks", PrepareOptions())


def test_a_film_of_ten_frames_that_hardly_moves_is_refused(tmp_path):
    path = film(tmp_path / "short.mp4", list(pan(1)) * 10)
    with pytest.raises(StageError, match="of 10 frames gives 1 photos") as caught:
        prepared(tmp_path, path)
    assert caught.value.key == "photos.video_step" and caught.value.file == str(path)


def test_a_clip_that_hardly_moves_does_not_cost_the_photos_beside_it(tmp_path):
    path = film(tmp_path / "short.mp4", list(pan(1)) * 10)
    photo = tmp_path / "a.jpg"
    cv2.imwrite(str(photo), next(iter(pan(1))))
    made = prepare_photos([path, photo], tmp_path / "photos", tmp_path / "masks", PrepareOptions())
    assert list(made["photos"]) == ["a.jpg"] and "hardly moves" in made["left_out"]["short.mp4"]
    assert [each.name for each in (tmp_path / "photos").iterdir()] == ["a.jpg"]


def test_a_film_that_does_not_open_is_named(tmp_path):
    path = tmp_path / "no.mp4"
    path.write_bytes(b"no film at all")
    with pytest.raises(StageError, match="cannot be opened") as caught:
        prepared(tmp_path, path)
    assert caught.value.file == str(path) and "photos in trees.tsv" in caught.value.key


def cut_film(tmp_path, share):
    whole = film(tmp_path / "whole.avi", pan(60))
    path = tmp_path / "cut.avi"
    path.write_bytes(whole.read_bytes()[: int(share * whole.stat().st_size)])
    return path


def test_a_film_that_breaks_off_gives_what_comes_before(tmp_path, caplog):
    listing = prepared(tmp_path, cut_film(tmp_path, 0.6))
    taken = [entry["frame"] for entry in listing["photos"].values()]
    assert len(taken) >= 3 and max(taken) < 45
    assert "cut.avi breaks off after" in caplog.text and "of 60 frames" in caplog.text


def test_a_film_of_which_too_little_is_left_is_named(tmp_path):
    path = cut_film(tmp_path, 0.02)
    with pytest.raises(StageError) as caught:
        prepared(tmp_path, path)
    assert caught.value.file == str(path)


def test_the_header_tells_size_and_seconds(tmp_path):
    assert size_of_capture(film(tmp_path / "a.mp4", pan(20))) == (WIDTH, HEIGHT, 2.0)


def test_a_header_that_promises_a_year_of_film_counts_no_more_than_the_file_holds(tmp_path):
    """Snakemake's own process reads it, for the memory to ask for."""
    path = film(tmp_path / "a.avi", pan(20))
    content = bytearray(path.read_bytes())
    for list_name, place in ((b"avih", 8 + 16), (b"strh", 8 + 32)):
        at = content.find(list_name) + place
        content[at : at + 4] = (2**31 - 1).to_bytes(4, "little")
    path.write_bytes(content)
    assert film_header(path).n_frames == 2**31 - 1
    assert len(sizes_of([path])) <= len(content)
