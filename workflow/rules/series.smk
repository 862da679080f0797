# Two dates of one tree, see docs/series.md. Only a series with two scans or more has such a page.


rule compare_series:
    input:
        skeletons=files_of_series("skeleton.graphml"),
        branches=files_of_series("branches.csv"),
        traits=files_of_series("traits.json"),
        segmented=files_of_series("segmented.ply"),
        scales=shared_files_of_series("scale.json"),
        poses=shared_files_of_series("poses.npz"),
        metric_poses=shared_files_of_series("metric_poses.npz"),
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
    log:
        "logs/compare_series/{series}.log",
    benchmark:
        "benchmarks/compare_series/{series}.tsv"
    conda:
        "../../envs/report.yaml"
    threads: 1
    resources:
        mem_mb=more_at_each_attempt(2000),
        runtime=20,
        gpu=0,
    params:
        code=code("compare_series", "report/series.html.j2", "report/style.css"),
        series=lambda wildcards: "".join(series_column(wildcards.series, "series")[:1]),
        trees=lambda wildcards: series_column(wildcards.series, "tree"),
        dates=lambda wildcards: series_column(wildcards.series, "date"),
        folder=lambda wildcards: f"results/series/{wildcards.series}",
    message:
        "{wildcards.series}: compare the dates of the tree"
    script:
        "../../scripts/compare_series.py"
