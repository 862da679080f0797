"""Print what a batch will cost, before anything is run: CPU hours, memory, disk and time.

Reads config/config.yaml and config/trees.tsv of the working directory and the headers of the
photos and clouds that they name; nothing is written. Where benchmarks/ holds three or more runs of
a stage, these correct the shipped rates. The time is that of so many cores at the least: all of
them busy, or the longest tree. --photos and --size stand for scans not yet taken; --formulas prints
what the numbers are made of.
Examples:

    python scripts/forecast.py --directory WORK
    python scripts/forecast.py --directory WORK --cores 32 --gpu
    python scripts/forecast.py --scans 30 --photos 250 --size 4000x3000
"""

import argparse
import logging
import os
import re
import sys
from dataclasses import replace

from cherrypicker.batch.config import CONFIG_FILE, read_config_file, resolve_config
from cherrypicker.batch.forecast import (
    forecast_jobs,
    forecast_text,
    formula_table,
    read_corrections,
)
from cherrypicker.batch.resources import size_of_photos
from cherrypicker.batch.scans import Scans
from cherrypicker.command.work_folder import batch_here
from cherrypicker.errors import StageError
from cherrypicker.files import load_yaml
from cherrypicker.mvs.backends.table import first_choice
from cherrypicker.photos import photo_error
from cherrypicker.runner import SCHEMA_FILE, stage_parser


def main(args: argparse.Namespace) -> None:
    """Print the forecast that the command line asks for."""
    if args.formulas:
        print(formula_table())
        return
    os.chdir(args.directory)
    if args.photos:
        # The working directory's config, if there is one
        config = read_config_file(may_miss=True)
        settings = resolve_config(load_yaml(SCHEMA_FILE), config, source=CONFIG_FILE)
        scan = size_of_photos([args.size] * args.photos, with_stereo(settings, args.gpu))
        scans = {f"scan{i + 1}": scan for i in range(args.scans)}
    else:
        batch = batch_here()
        own = {name: with_stereo(each, args.gpu) for name, each in batch.settings_of.items()}
        scans = Scans(replace(batch, settings_of=own)).sizes()
        for name, row in batch.trees.items():
            if row.is_photo_scan and not scans[name].photos:
                raise photo_error(
                    f"tree {name}: the folder holds no photo that can be read", row.photos
                )
    jobs = forecast_jobs(scans, read_corrections(scans), args.cores)
    print(forecast_text(jobs, args.cores))


def with_stereo(settings: dict, has_gpu: bool) -> dict:
    """Return a tree's config with the stereo that it has with a GPU, or without one."""
    backend = first_choice(settings["mvs"]["backend"], has_gpu)
    return settings | {"mvs": settings["mvs"] | {"backend": backend}}


def photo_size(text: str) -> tuple[int, int]:
    """Parse a size in pixels such as ``4000x3000``."""
    match = re.fullmatch(r"([1-9]\d*)x([1-9]\d*)", text)
    if not match:
        raise argparse.ArgumentTypeError(f"{text!r} is no size such as 4000x3000")
    return int(match[1]), int(match[2])


def count(text: str) -> int:
    """Parse a number of one or more."""
    if not text.isdecimal() or int(text) < 1:
        raise argparse.ArgumentTypeError(f"{text!r} is no number of one or more")
    return int(text)


parser = stage_parser(__doc__)
parser.add_argument("--directory", default=".", help="working directory, default the current one")
parser.add_argument("--scans", type=count, default=1, help="with --photos: how many scans")
parser.add_argument("--photos", type=count, help="photos of each scan, instead of trees.tsv")
parser.add_argument(
    "--size", type=photo_size, default=(4000, 3000), help="with --photos: size of a photo, px"
)
parser.add_argument(
    "--cores", type=count, default=os.cpu_count() or 1, help="cores in all, default this machine's"
)
parser.add_argument("--gpu", action="store_true", help="depth maps on a GPU")
parser.add_argument("--formulas", action="store_true", help="print the formulas and rates instead")

if __name__ == "__main__":
    logging.basicConfig(level=logging.WARNING, format="%(message)s", stream=sys.stderr)
    try:
        main(parser.parse_args())
    except StageError as error:
        raise SystemExit(f"error: {error.describe()}") from None
