# The benchmark of traits, see docs/lab/traits.md. Only `snakemake benchmark_traits` and `fit_intervals`
# run it.

TRAITS_BENCHMARK = SETTINGS["benchmark"]["traits"]


wildcard_constraints:
    tree_seed=r"\d+",
    grown="thin|bearing|conifer",


rule benchmark_traits:
    input:
        "results/benchmark/traits/table.md",


rule measure_grown_traits:
    output:
        cases=ensure(
            "results/benchmark/traits/{grown}/{tree_seed}.json", non_empty=True
        ),
    log:
        "logs/measure_grown_traits/{grown}_{tree_seed}.log",
    benchmark:
        "benchmarks/measure_grown_traits/{grown}_{tree_seed}.tsv"
    conda:
        "../../../envs/pointcloud.yaml"
    threads: 1
    resources:
        mem_mb=lambda wildcards, attempt: 2000 * attempt,
        runtime=30,
    params:
        code=code("lab/measure_trait_cases"),
        source=lambda wildcards: wildcards.grown,
        number=lambda wildcards: int(wildcards.tree_seed),
        n_points=TRAITS_BENCHMARK["n_points"],
    message:
        "{wildcards.grown} tree {wildcards.tree_seed}: traits beside their truth"
    script:
        "../../../scripts/lab/measure_trait_cases.py"


use rule report_skeletons as report_traits_benchmark with:
    input:
        measured=[
            *expand(
                "results/benchmark/traits/thin/{tree_seed}.json",
                tree_seed=seeds_of(TRAITS_BENCHMARK),
            ),
            *expand(
                "results/benchmark/traits/bearing/{tree_seed}.json",
                tree_seed=seeds_of(
                    TRAITS_BENCHMARK, "first_bearing_seed", "n_bearing_trees"
                ),
            ),
        ],
    output:
        table=ensure("results/benchmark/traits/table.md", non_empty=True),
    log:
        "logs/report_traits_benchmark.log",
    params:
        code=code("lab/report_benchmark"),
        kind="traits",
    message:
        "table of the benchmark of traits"
