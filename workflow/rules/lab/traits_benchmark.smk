# The benchmark of traits, see docs/lab/traits.md. Only `snakemake benchmark_traits` runs it.

TRAITS_BENCHMARK = SETTINGS["benchmark"]["traits"]
BEARING_TREE_SEEDS = seeds_of(TRAITS_BENCHMARK, "first_bearing_seed", "n_bearing_trees")


wildcard_constraints:
    tree_seed=r"\d+",


rule benchmark_traits:
    input:
        "results/benchmark/traits/table.md",


rule measure_traits_benchmark:
    output:
        pairs=ensure("results/benchmark/traits/{tree_seed}/pairs.json", non_empty=True),
    log:
        "logs/measure_traits_benchmark/{tree_seed}.log",
    benchmark:
        "benchmarks/measure_traits_benchmark/{tree_seed}.tsv"
    conda:
        "../../../envs/pointcloud.yaml"
    threads: 1
    resources:
        mem_mb=lambda wildcards, attempt: 2000 * attempt,
        runtime=30,
    params:
        code=code("lab/measure_traits_benchmark"),
        tree_seed=lambda wildcards: int(wildcards.tree_seed),
        bearing=lambda wildcards: int(wildcards.tree_seed) in BEARING_TREE_SEEDS,
        n_points=TRAITS_BENCHMARK["n_points"],
    message:
        "generated tree {wildcards.tree_seed}: traits beside their truth"
    script:
        "../../../scripts/lab/measure_traits_benchmark.py"


use rule report_skeletons as report_traits_benchmark with:
    input:
        measured=expand(
            "results/benchmark/traits/{tree_seed}/pairs.json",
            tree_seed=sorted({*seeds_of(TRAITS_BENCHMARK), *BEARING_TREE_SEEDS}),
        ),
    output:
        table=ensure("results/benchmark/traits/table.md", non_empty=True),
        figure=ensure("results/benchmark/traits/traits.png", non_empty=True),
    log:
        "logs/report_traits_benchmark.log",
    params:
        code=code("lab/report_benchmark"),
        kind="traits",
    message:
        "table and figure of the benchmark of traits"
