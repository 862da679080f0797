"""Judge the comparison of two finished scans of a generated tree by what truly changed.

Writes JSON. The scenes are those of `snakemake orchard`, the second with `tree_seed` and `season`
of `orchard.chosen`. Example:

    python scripts/lab/judge_series_scans.py --results results/a results/b \\
        --truths scenes/8815/truth scenes/8803/truth --judged pair.json
"""

import lab_path  # noqa: F401
from cherrypicker.files import write_json
from cherrypicker.runner import run, stage_parser
from cherrypicker_lab.series.scans import judge_scans


def main(results, truths, judged):
    write_json(judged, judge_scans(results, truths))


parser = stage_parser(__doc__)
parser.add_argument("--results", nargs=2, required=True, help="results folders, first date first")
parser.add_argument("--truths", nargs=2, required=True, help="folders truth of their scenes")
parser.add_argument("--judged", required=True, help="JSON to write")
run(main, parser, globals().get("snakemake"))
