# The fit of the factors of the traits' 90 % intervals, see docs/traits.md. Only `snakemake
# fit_intervals` runs it.


rule fit_intervals:
    input:
        "results/benchmark/intervals/table.md",


rule measure_scan_intervals:
    input:
        traits=of_scan("results", file="traits.json"),
    output:
        cases=ensure("results/benchmark/traits/scans/{tree_seed}.json", non_empty=True),
    log:
        "logs/measure_scan_intervals/{tree_seed}.log",
    conda:
        "../../../envs/pointcloud.yaml"
    threads: 1
    resources:
        mem_mb=lambda wildcards, attempt: 2000 * attempt,
        runtime=30,
    params:
        code=code("lab/measure_trait_cases"),
        source=of_scan("source"),
        results=of_scan("results"),
        truth=of_scan("truth"),
    message:
        "scan {wildcards.tree_seed}: traits beside their truth"
    script:
        "../../../scripts/lab/measure_trait_cases.py"


rule fit_interval_factors:
    input:
        cases=interval_cases(),
        present=str(LIBRARY / "cherrypicker/geometry/interval_factors.yaml"),
    output:
        factors=ensure(
            "results/benchmark/intervals/interval_factors.yaml", non_empty=True
        ),
        table=ensure("results/benchmark/intervals/table.md", non_empty=True),
    log:
        "logs/fit_interval_factors.log",
    conda:
        "../../../envs/pointcloud.yaml"
    threads: 1
    resources:
        mem_mb=lambda wildcards, attempt: 2000 * attempt,
        runtime=10,
    params:
        code=code("lab/fit_interval_factors"),
        checked=INTERVALS["checked"],
    message:
        "factors of the traits' intervals"
    script:
        "../../../scripts/lab/fit_interval_factors.py"
