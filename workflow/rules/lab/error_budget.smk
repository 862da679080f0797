# What each stage costs on generated scenes, see docs/lab/error_budget.md. Only `snakemake error_budget`
# runs it: for every tree of the batch whose photos have the scene's truth beside them.


rule error_budget:
    input:
        "results/error_budget/table.md",


rule measure_error_budget:
    input:
        traits="results/{tree}/traits.json",
        segmented="results/{tree}/segmented.ply",
        skeleton="results/{tree}/skeleton.graphml",
        poses="results/{tree}/metric_poses.npz",
        database="results/{tree}/sfm/database.db",
        masks="results/{tree}/sky",
        truth_files=truth_files_of,
    output:
        budget=ensure("results/error_budget/{tree}/budget.json", non_empty=True),
    log:
        "logs/measure_error_budget/{tree}.log",
    benchmark:
        "benchmarks/measure_error_budget/{tree}.tsv"
    wildcard_constraints:
        tree=any_of(TREES_WITH_TRUTH),
    conda:
        "../../../envs/photogrammetry.yaml"
    # a workflow of its own runs inside
    threads: lambda wildcards: workflow.cores
    resources:
        mem_mb=lambda wildcards, attempt: 8000 * attempt,
        runtime=240,
        gpu=stereo_gpus,
    params:
        code=code("lab/measure_error_budget"),
        tree="{tree}",
        found=of_tree(lambda tree: f"results/{tree}"),
        truth=truth_of,
        row=of_tree(lambda tree: vars(TREES[tree])),
        settings=of_tree(lambda tree: BATCH.settings_of[tree]),
        snakefile=str(PROJECT / "Snakefile"),
    message:
        "{wildcards.tree}: what each stage costs"
    script:
        "../../../scripts/lab/measure_error_budget.py"


use rule report_skeletons as report_error_budget with:
    input:
        measured=expand(
            "results/error_budget/{tree}/budget.json", tree=TREES_WITH_TRUTH
        ),
    output:
        table=ensure("results/error_budget/table.md", non_empty=True),
    log:
        "logs/report_error_budget.log",
    params:
        code=code("lab/report_benchmark"),
        kind="error_budget",
    message:
        "table of what each stage costs"
