# Two dates of one tree, see docs/series.md. Only a series with two scans or more has such a page.


rule compare_series:
    input:
        skeletons=of_series(file_of("results/{tree}/skeleton.graphml")),
        branches=of_series(file_of("results/{tree}/branches.csv")),
        photo_checks=of_series(photo_only("results/{tree}/photo_check.json")),
        limbs=of_series(file_of("results/{tree}/limbs.csv")),
        traits=of_series(file_of("results/{tree}/traits.json")),
        segmented=of_series(file_of("results/{tree}/segmented.ply")),
        scales=of_series(photo_only("results/{scan}/scale.json")),
        aligns=of_series(photo_only("results/{scan}/align.json")),
        pruning=of_series(part_of("pruning", "csv")),
    output:
        page=report(
            ensure("results/series/{series}/report.html", non_empty=True),
            caption="../report/series.rst",
            category="Series",
            labels={"series": "{series}"},
        ),
        numbers="results/series/{series}/series.json",
        branch_table="results/series/{series}/branches.csv",
        growth="results/series/{series}/growth.csv",
        shoots="results/series/{series}/shoots.csv",
        cuts="results/series/{series}/cuts.csv",
        bearing="results/series/{series}/bearing.csv",
    log:
        "logs/compare_series/{series}.log",
    benchmark:
        "benchmarks/compare_series/{series}.tsv"
    wildcard_constraints:
        series=any_of(SERIES),
    priority: 1
    conda:
        "../../envs/report.yaml"
    threads: 1
    resources:
        mem_mb=lambda wildcards, attempt: 2000 * attempt,
        runtime=20,
    params:
        code=code(
            "compare_series",
            *("report/series.html.j2", "report/style.css", "bearing/rates.yaml"),
        ),
        series=lambda wildcards: "".join(
            {row.series for row in SERIES.get(wildcards.series, ())}
        ),
        trees=lambda wildcards: [row.tree for row in SERIES.get(wildcards.series, ())],
        dates=lambda wildcards: [row.date for row in SERIES.get(wildcards.series, ())],
        unfinished=lambda wildcards: [
            row.tree
            for row in ALL_SERIES.get(wildcards.series, ())
            if row not in SERIES[wildcards.series]
        ],
    message:
        "{wildcards.series}: compare the dates of the tree"
    script:
        "../../scripts/compare_series.py"
