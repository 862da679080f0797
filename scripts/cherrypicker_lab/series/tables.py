"""Table of the benchmark of two dates."""

from cherrypicker.errors import StageError
from cherrypicker_lab.series.pairs import KINDS
from cherrypicker_lab.tables import markdown_table

WORDS = {
    "noise": "exact surface with 2 mm of noise",
    "seen": "as the dense stage sees it",
}
HEAD = (
    "what became of the tree",
    "pairs",
    "F1 of axes of 10 cm and more (worst)",
    "cuts right of true, found",
    "removed length",
    "removed volume",
    "the same by the first scan's radii (worst)",
    "falsely removed (worst)",
    "new length",
    "falsely new",
)


def write_table(reports):
    """The tables as Markdown, one a walk with a row a kind of change.

    Sums are over all pairs of a row; errors of lengths and volumes are of these sums, those in
    brackets the worst pair's. Raises a `StageError` if there is no report.
    """
    if not reports:
        raise StageError("no pair was measured", key="benchmark.series")
    parts = []
    for walk, words in WORDS.items():
        those = [report for report in reports if report["walk"] == walk]
        if not those:
            continue
        seeds = [report["seed"] for report in those]
        rows = []
        for kind in KINDS:
            pairs = [report["pairs"][kind] for report in those]
            rows.append([kind, str(len(pairs)), *_cells(pairs)])
        parts.append(
            f"{len(those)} trees, seeds {min(seeds)} to {max(seeds)}, {words}:\n\n"
            f"{markdown_table(HEAD, rows)}"
        )
    return "\n".join(parts)


def _cells(pairs):
    def total(name):
        return sum(pair[name] for pair in pairs)

    false = [pair["false_removed_length_m"] / pair["length_m"] for pair in pairs]
    cuts = [pair["cuts"] for pair in pairs]
    long_axes = [pair["axes_10cm"] for pair in pairs]
    n = {key: sum(cut[key] for cut in cuts) for key in ("n_true", "n_found", "n_right")}
    cells = [f"{_f1(long_axes):.3f} ({min(_f1([one]) for one in long_axes):.3f})"]
    cells += [f"{n['n_right']} of {n['n_true']}, {n['n_found']}"]
    if n["n_true"]:
        cells += [
            _off(total("removed_length_m"), total("true_removed_length_m")),
            _off(total("removed_volume_m3"), total("true_removed_volume_m3")),
            _with_worst(pairs, "removed_volume_m3", "seen_removed_volume_m3"),
        ]
    else:
        cells += [f"{total('removed_length_m'):.2f} m", "", ""]
    cells += [f"{100 * sum(false) / len(false):.2f} % ({100 * max(false):.2f} %)"]
    true_new = total("true_new_length_m")
    cells += [
        _off(total("new_length_m"), true_new) if true_new else f"{total('new_length_m'):.2f} m"
    ]
    return [*cells, f"{100 * total('false_new_length_m') / total('length_m'):.1f} %"]


def _f1(counts):
    right = sum(each["n_right"] for each in counts)
    return 2 * right / max(sum(each["n_true"] + each["n_found"] for each in counts), 1)


def _off(found, true):
    return f"{100 * (found / true - 1):+.0f} %"


def _with_worst(pairs, found, true):
    off = [pair[found] / pair[true] - 1 for pair in pairs]
    whole = sum(pair[found] for pair in pairs) / sum(pair[true] for pair in pairs) - 1
    return f"{100 * whole:+.1f} % ({100 * max(off, key=abs):+.1f} %)"
