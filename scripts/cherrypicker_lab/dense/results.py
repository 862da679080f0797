"""The benchmark's results as tables of Markdown."""

from __future__ import annotations

import os
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

from cherrypicker.errors import StageError
from cherrypicker.files import read_json
from cherrypicker_lab.dense.backends import ALL_BACKENDS
from cherrypicker_lab.dense.surface import CLASSES

BACKEND_NAMES = {name: backend.title for name, backend in ALL_BACKENDS.items()}
CAMERA_NAMES = {"true": "true", "sfm": "from SfM"}
CLASS_NAMES = {
    "trunk": "trunk",
    "branch_30mm": "branches ≥ 30 mm",
    "branch_10_30mm": "10 to 30 mm",
    "branch_5_10mm": "5 to 10 mm",
    "branch_below_5mm": "< 5 mm",
    "wood_30mm": "all wood ≥ 30 mm",
}
FULL_SIZE = "full"


@dataclass(frozen=True)
class Result:
    """One run: where its files lie, what was measured and, for a rendered scene, its scores."""

    folder: Path
    size: str  # "full", or the megapixels of the photos
    measured: dict  # as :func:`cherrypicker_lab.dense.measure.measure_stereo` reports
    scores: dict | None  # as :func:`cherrypicker_lab.dense.scoring.score_file` reports

    @property
    def scan(self) -> str:
        """Name of the scene or the folder of photos."""
        return self.measured["scan"]

    @property
    def cameras(self) -> str:
        """Either "true" or "sfm"."""
        return self.measured["cameras"]

    @property
    def backend(self) -> str:
        """Key of `BACKEND_NAMES`."""
        return self.measured["backend"]


def read_results(measurements: Iterable[str | os.PathLike]) -> list[Result]:
    """Read the measurements, with ``scores.json`` where it lies beside.

    The size is the name of the folder above a measurement's own.

    Raises
    ------
    StageError
        If there is none, or one is broken.
    """
    results = []
    for path in map(Path, measurements):
        scores = path.parent / "scores.json"
        found = read_json(scores) if scores.is_file() else None
        results.append(Result(path.parent, path.parent.parent.name, read_json(path), found))
    if not results:
        raise StageError("nothing was measured", key="benchmark.scenes, benchmark.photos")
    backends = list(BACKEND_NAMES)
    return sorted(
        results,
        key=lambda r: (r.scores is None, r.scan, r.cameras != "true", backends.index(r.backend)),
    )


def at_full_size(results: list[Result]) -> list[Result]:
    """Return the runs on photos as they are."""
    return [result for result in results if result.size == FULL_SIZE]


def write_table(results: list[Result], left_out: Iterable[str] = ()) -> str:
    """Return the tables as Markdown.

    Parameters
    ----------
    left_out : iterable of str
        Backends that could not run here, to be named.
    """
    full = at_full_size(results)
    parts = [_conditions(results, left_out), _cost_table(full)]
    scored = [result for result in full if result.scores is not None]
    if scored:
        parts += [_score_table(scored), _class_table(scored)]
    parts.append(_size_table([r for r in results if r.backend == "cpu"]))
    return "\n".join(part for part in parts if part)


def _conditions(results: list[Result], left_out: Iterable[str]) -> str:
    first = results[0].measured
    lines = [
        f"Measured with {first['threads']} thread(s) of {first['processor']}, "
        f"pycolmap {first['pycolmap']}."
    ]
    for name in left_out:
        reason = (
            "this pycolmap has no CUDA" if ALL_BACKENDS[name].needs_cuda else "it cannot run here"
        )
        lines.append(f"{BACKEND_NAMES[name]} is left out: {reason}.")
    return "\n".join(lines) + "\n"


def _rows(header: list[str], rows: list[list[str]], n_left: int) -> str:
    rule = ["---"] * n_left + ["---:"] * (len(header) - n_left)
    lines = [header, rule, *rows]
    return "\n".join("| " + " | ".join(line) + " |" for line in lines) + "\n"


def _names(result: Result) -> list[str]:
    return [result.scan, CAMERA_NAMES[result.cameras], BACKEND_NAMES[result.backend]]


def _cost_table(results: list[Result]) -> str:
    header = ["scan", "cameras", "backend", "photos", "megapixels", "CPU s a megapixel",
              "fusion CPU s a megapixel", "wall s a megapixel", "peak MB (depth)",
              "peak MB (fusion)", "sparse points within 0.5 %", "of those with depth"]  # fmt: skip
    rows = []
    for result in results:
        m = result.measured
        rows.append(
            [
                *_names(result),
                f"{m['n_photos']}",
                f"{m['megapixels']:.1f}",
                f"{m['cpu_s_per_megapixel']:.1f}",
                f"{m['fusion_cpu_s_per_megapixel']:.2f}",
                f"{m['wall_s_per_megapixel']:.1f}",
                f"{m['depth']['peak_mb']:.0f}",
                f"{m['fusion']['peak_mb']:.0f}",
                f"{100 * m['agreement']['share']:.1f} %",
                f"{100 * m['agreement']['share_where_known']:.1f} %",
            ]
        )
    return "### Cost and agreement\n\n" + _rows(header, rows, 3)


def _score_table(results: list[Result]) -> str:
    header = ["scan", "cameras", "backend"]
    header += [f"{what} {size}" for size in ("5 mm", "10 mm", "20 mm") for what in ("P", "R", "F1")]
    header += ["F1 10 mm, thinned", "R 10 mm, all surface"]
    rows = []
    for result in results:
        row = _names(result)
        for rates in result.scores["all"].values():
            row += [f"{rates[k]:.3f}" for k in ("accuracy", "completeness")]
            row.append(f"**{rates['f1']:.3f}**")
        row.append(f"{result.scores['thinned']['10mm']['f1']:.3f}")
        row.append(f"{result.scores['all']['10mm']['completeness_all']:.3f}")
        rows.append(row)
    return "### Accuracy (P), completeness (R), F1\n\n" + _rows(header, rows, 3)


def _class_table(results: list[Result]) -> str:
    header = ["scan", "cameras", "backend", "at"]
    names = [*CLASSES, "wood_30mm"]
    header += [f"{CLASS_NAMES[name]}: P / R / F1" for name in names]
    rows = []
    for result in results:
        for tolerance in ("5mm", "10mm", "20mm"):
            cells = [_class_cell(result.scores[name][tolerance]) for name in names]
            rows.append([*_names(result), tolerance.replace("mm", " mm"), *cells])
    return "### By wood\n\n" + _rows(header, rows, 4)


def _class_cell(rates: dict) -> str:
    if rates["completeness"] is None:
        return "none"
    values = [rates[k] for k in ("accuracy", "completeness", "f1")]
    return " / ".join("–" if value is None else f"{value:.2f}" for value in values)


def _size_table(results: list[Result]) -> str:
    """Runs of the CPU backend on scans that were measured at several sizes."""
    several = {
        (r.scan, r.cameras) for r in results if r.size != FULL_SIZE
    }  # full size stands beside the others only where there are others
    chosen = [r for r in results if (r.scan, r.cameras) in several]
    if not chosen:
        return ""
    chosen.sort(key=lambda r: (r.scan, r.cameras, r.measured["megapixels"]))
    header = ["scan", "cameras", "megapixels a photo", "megapixels", "CPU s", "CPU s a megapixel",
              "peak MB", "F1 10 mm"]  # fmt: skip
    rows = []
    for r in chosen:
        m = r.measured
        f1 = "–" if r.scores is None else f"{r.scores['all']['10mm']['f1']:.3f}"
        rows.append(
            [
                r.scan,
                CAMERA_NAMES[r.cameras],
                f"{m['megapixels_per_photo']:.2f}",
                f"{m['megapixels']:.1f}",
                f"{m['depth']['cpu_s']:.0f}",
                f"{m['cpu_s_per_megapixel']:.1f}",
                f"{m['depth']['peak_mb']:.0f}",
                f1,
            ]
        )
    return "### Time and size of the photos (our CPU backend)\n\n" + _rows(header, rows, 2)
