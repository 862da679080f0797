# The benchmark of two dates of one tree, see docs/lab/series.md. Only `snakemake benchmark_series` runs it.

SERIES_BENCHMARK = SETTINGS["benchmark"]["series"]


wildcard_constraints:
    walk="noise|seen",


rule benchmark_series:
    input:
        "results/benchmark/series/table.md",


rule measure_series_benchmark:
    output:
        pairs=ensure(
            "results/benchmark/series/{walk}/{tree_seed}/pairs.json", non_empty=True
        ),
    log:
        "logs/measure_series_benchmark/{walk}/{tree_seed}.log",
    benchmark:
        "benchmarks/measure_series_benchmark/{walk}/{tree_seed}.tsv"
    conda:
        "../../../envs/pointcloud.yaml"
    threads: 1
    resources:
        mem_mb=lambda wildcards, attempt: 2000 * attempt,
        runtime=30,
    params:
        code=code("lab/measure_series_benchmark"),
        tree_seed=lambda wildcards: int(wildcards.tree_seed),
        walk=lambda wildcards: wildcards.walk,
        n_points=SERIES_BENCHMARK["n_points"],
    message:
        "generated tree {wildcards.tree_seed}, {wildcards.walk}: two dates beside their truth"
    script:
        "../../../scripts/lab/measure_series_benchmark.py"


use rule report_skeletons as report_series_benchmark with:
    input:
        measured=expand(
            "results/benchmark/series/{walk}/{tree_seed}/pairs.json",
            walk=SERIES_BENCHMARK["walks"],
            tree_seed=seeds_of(SERIES_BENCHMARK),
        ),
    output:
        table=ensure("results/benchmark/series/table.md", non_empty=True),
    log:
        "logs/report_series_benchmark.log",
    params:
        code=code("lab/report_benchmark"),
        kind="series",
    message:
        "table of the benchmark of two dates"
