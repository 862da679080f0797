"""Make a work folder: a commented table and config, with photos found by sub-folder.

Every sub-folder with three photos or more, or a video, becomes a row of config/trees.tsv, every
PLY, LAS or LAZ a row of its own; the date is that of the first photo. A folder of grey PNG files
that are named as the photos in or beside whose folder it lies are their masks. Nothing that is
there is overwritten.
Examples:

    cherrypicker init MY_FOLDER
    cherrypicker init MY_FOLDER --marker_dictionary DICT_4X4_50 --marker_sides_m 7:0.20
"""

import argparse
import datetime
import os
import re
from collections.abc import Iterator
from pathlib import Path

from PIL import ExifTags, Image

from cherrypicker.batch.config import CONFIG_FILE
from cherrypicker.batch.trees import folder_name, read_trees
from cherrypicker.errors import StageError
from cherrypicker.files import PROJECT, csv_text, files_with, write_text
from cherrypicker.intake.kinds import Kind, captures_in, kind_of
from cherrypicker.intake.stills import tags_of
from cherrypicker.markers.references import check_scale
from cherrypicker.photos import MIN_PHOTOS, UNREADABLE
from cherrypicker.runner import stage_parser

TABLE_FILE = "config/trees.tsv"
COLUMNS = (
    *("tree", "photos", "masks", "cloud"),
    *("marker_dictionary", "marker_sides_m", "scale", "date"),
)
_CLOUD_SUFFIXES = (".ply", ".las", ".laz")
_OWN_FOLDERS = ("config", "results", "logs", "benchmarks", "check")
_TABLE_HEAD = """\
# One row a scan, columns separated by tabs; an empty cell means the default.
# tree: its id. photos: a folder of photos, or cloud: a ready point cloud instead.
# marker_dictionary, marker_sides_m: the printed marker, such as DICT_4X4_50 and 7:0.20 (metres).
# masks: a folder of masks for the photos, black where nothing is to be looked at.
# scale: empty with a marker, else metres per unit, or none for results without metres.
# date: of the scan. All columns: config/README.md of the project.
"""
_CONFIG_HEAD = """\
# The common keys at their defaults: take the # off a line, and off its section's, to change it.
# All keys: workflow/schemas/config.schema.yaml of the project.
"""

parser = stage_parser(__doc__)
parser.add_argument("folder", metavar="FOLDER", help="the work folder, made if it is not there")
parser.add_argument("--photos", help="where to look for photos and clouds, default FOLDER itself")
parser.add_argument("--marker_dictionary", default="", help="of all scans, such as DICT_4X4_50")
parser.add_argument("--marker_sides_m", default="", help="of all scans, such as 7:0.20")
parser.add_argument("--scale", default="", help="none, or metres per unit, where no marker is")


def main(args: argparse.Namespace) -> int:
    """Write table and config; return 0."""
    if args.marker_dictionary or args.marker_sides_m:
        check_scale("", "marker", args.marker_dictionary, args.marker_sides_m)
    folder = Path(args.folder)
    for name in (TABLE_FILE, CONFIG_FILE):
        if (folder / name).exists():
            raise StageError("there is one already, nothing was written", file=folder / name)
    if args.photos and not Path(args.photos).is_dir():
        raise StageError("no such folder, nothing was written", file=args.photos, key="--photos")
    rows = []
    for row in find_scans(Path(args.photos or folder), folder):
        told = vars(args) if row["photos"] else {}  # the marker's columns, of photos alone
        rows.append({name: row.get(name) or told.get(name) for name in COLUMNS})
    write_text(folder / TABLE_FILE, _TABLE_HEAD + csv_text(rows, COLUMNS, "\t"))
    write_text(folder / CONFIG_FILE, commented_config())
    read_trees(folder / TABLE_FILE)
    print(f"{folder / TABLE_FILE}: {len(rows)} scans")
    if not rows:
        where = args.photos or folder
        print(
            f"nothing found below {where}: looked for folders with {MIN_PHOTOS} photos or a video "
            f"in them, and for files {', '.join(_CLOUD_SUFFIXES)}; write the table by hand, or "
            "say where with --photos"
        )
    print(f"{folder / CONFIG_FILE}: the common keys, commented out")
    if rows and not (args.marker_sides_m or args.scale):
        print("fill in the marker of each scan (or scale) in the table")
    print(f"then: cherrypicker check -d {folder}; cherrypicker run -d {folder}")
    return 0


def find_scans(root: Path, folder: Path) -> Iterator[dict[str, str]]:
    """Yield a row for every folder of photos and every ready cloud below `root`.

    Paths inside the work folder are written as seen from there.
    """
    # From the root of the disk, links as they are
    root, folder = (Path(os.path.abspath(path)) for path in (root, folder))

    def as_seen(path: Path) -> str:
        return str(path.relative_to(folder) if path.is_relative_to(folder) else path)

    seen: set[str] = set()
    captures = {place: captures_in(place) for place in _folders(root)}
    masks = _mask_folders(captures)
    for place, photos in captures.items():
        if place in masks.values():
            continue
        if len(photos) >= MIN_PHOTOS or any(kind_of(path) is Kind.VIDEO for path in photos):
            row = {"photos": as_seen(place), "date": date_of(photos[0])}
            row |= {"masks": as_seen(masks[place])} if place in masks else {}
            yield {"tree": _id_of(place, root, seen)} | row
        for path in files_with(place, _CLOUD_SUFFIXES):
            tree = _id_of(path.with_suffix(""), root, seen)
            yield {"tree": tree, "photos": "", "cloud": as_seen(path)}


def _folders(root: Path) -> Iterator[Path]:
    """Yield every folder below `root` once; what is linked after what is there, nothing upward."""
    waiting, seen = [root], set(root.resolve().parents)
    while waiting:
        for place, names, _ in os.walk(waiting.pop(0)):
            real = Path(place).resolve()
            names[:] = sorted(
                name
                for name in names
                if real not in seen and not name.startswith(".") and name not in _OWN_FOLDERS
            )
            if real not in seen:
                yield Path(place)
            seen.add(real)
            waiting += [path for name in names if (path := Path(place, name)).is_symlink()]


def _mask_folders(captures: dict[Path, list[Path]]) -> dict[Path, Path]:
    """Return the folder of masks of each folder of photos that has one, in it or beside it.

    Masks are grey PNG files, each of which bears the name of a photo.
    """
    names = {
        place: {name for path in photos for name in (path.name, path.stem)}
        for place, photos in captures.items()
    }
    found: dict[Path, Path] = {}
    for place, pictures in captures.items():
        if not (pictures and all(map(_is_grey_png, pictures))):
            continue
        above = place.parent
        photos = [
            other
            for other in captures.keys() - {place}
            # tree/masks, or masks beside tree; masks/tree of photos/tree
            if above in (other, other.parent)
            or other == above.parent / other.parent.name / place.name
            if all(path.stem in names[other] for path in pictures)
        ]
        if len(photos) == 1:
            found.setdefault(photos[0], place)
    return found


def _is_grey_png(path: Path) -> bool:
    try:
        with Image.open(path) as image:
            return path.suffix.lower() == ".png" and image.mode in ("1", "L", "LA", "P")
    except UNREADABLE:
        return False


def _id_of(path: Path, root: Path, seen: set[str]) -> str:
    """Id of a scan: its folder's name, with those above it where that is taken."""
    parts = [part for part in path.relative_to(root).parts if part != "photos"] or [root.name]
    names = [folder_name("_".join(parts[i:]), empty="tree") for i in range(len(parts))[::-1]]
    name = next((each for each in names if each.casefold() not in seen), names[-1])
    while name.casefold() in seen:
        name += "_"
    seen.add(name.casefold())
    return name


def date_of(photo: Path) -> str:
    """Return the ISO date that a photo was taken on by its EXIF tags; empty where it tells none."""
    try:
        details = tags_of(photo).get_ifd(ExifTags.IFD.Exif)
        text = str(details.get(ExifTags.Base.DateTimeOriginal, ""))
        return datetime.date.fromisoformat(text[:10].replace(":", "-")).isoformat()
    except ValueError:
        return ""


def commented_config() -> str:
    """Return the project's common keys, all but the first commented out."""
    shipped = (PROJECT / CONFIG_FILE).read_text(encoding="utf-8")
    before_key = re.compile(r"^(?= *[^#\s])", re.MULTILINE)
    head, first, rest = before_key.split(shipped.partition("\n\n")[2], maxsplit=2)
    return f"{_CONFIG_HEAD}\n{head}{first}{before_key.sub('#', rest)}"
