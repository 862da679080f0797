# What the rules of the benchmark of dense stereo share.

from cherrypicker.photos import photos_in
from cherrypicker_lab.dense.backends import ALL_BACKENDS, backends_here
from cherrypicker_lab.dense.jobs import (
    benchmark_runs,
    is_preset_name,
    megapixels_of,
    scan_folders,
)

BENCHMARK = SETTINGS["benchmark"]
BENCHMARK_PRESETS = [name for name in BENCHMARK["scenes"] if is_preset_name(name)]
BENCHMARK_SCENES = [Path(entry).name for entry in BENCHMARK["scenes"]]


def load_benchmark():
    """Return the folder of each scan of the benchmark, and the folders of all runs."""
    try:
        return scan_folders(BENCHMARK), benchmark_runs(BENCHMARK, backends_here())
    except StageError as error:
        raise WorkflowError(error.describe())


BENCHMARK_FOLDERS, BENCHMARK_RUNS = load_benchmark()


def benchmark_photos(wildcards):
    """Return the folder of a scan's photos."""
    folder = BENCHMARK_FOLDERS[wildcards.scan]
    return str(folder / "photos" if wildcards.scan in BENCHMARK_SCENES else folder)


def benchmark_photo_files(wildcards):
    """Return a scan's photos, for a preset the list of those that were rendered."""
    if wildcards.scan in BENCHMARK_PRESETS:
        return str(BENCHMARK_FOLDERS[wildcards.scan] / "rendered.json")
    photos = map(str, photos_in(benchmark_photos(wildcards)))
    return [path for path in photos if is_plain(path)]


def benchmark_truth(wildcards):
    """Return the folder of a scene's truth."""
    return str(BENCHMARK_FOLDERS[wildcards.scan] / "truth")


def benchmark_sky(wildcards):
    """Return the sky masks that the stereo leaves out, none where that is switched off."""
    if not cfg("mvs.use_sky_masks")(wildcards):
        return []
    return f"results/benchmark/dense/{wildcards.scan}/sky"


def benchmark_result_files():
    """Return what the tables and figures are made from."""
    files = []
    for run in BENCHMARK_RUNS:
        files.append(f"{run}/measurement.json")
        if run.split("/")[3] in BENCHMARK_SCENES:
            files.append(f"{run}/scores.json")
    return files
