# Traits of a tree from its graphs and its labelled cloud, and hand measurements beside them.


rule measure_traits:
    input:
        skeleton="results/{tree}/skeleton.graphml",
        segmented="results/{tree}/segmented.ply",
        target="results/{tree}/target.json",
        scale=photo_only("results/{scan}/scale.json"),
        metric_poses=photo_only("results/{scan}/metric_poses.npz"),
        sparse=photo_only("results/{scan}/sfm/report.json"),
        cameras=photo_only("results/{scan}/dense/poses.npz"),
        evidence=photo_only("results/{scan}/evidence"),
        photo_check=photo_only("results/{tree}/photo_check.json"),
        edits=branch(
            of_tree(EDITED_TREES.__contains__), then="results/{tree}/edits.json"
        ),
    output:
        traits=ensure("results/{tree}/traits.json", non_empty=True),
        branches=ensure("results/{tree}/branches.csv", non_empty=True),
        branch_points=ensure("results/{tree}/branches.ply", non_empty=True),
        limbs=ensure("results/{tree}/limbs.csv", non_empty=True),
    log:
        "logs/measure_traits/{tree}.log",
    benchmark:
        "benchmarks/measure_traits/{tree}.tsv"
    conda:
        "../../envs/pointcloud.yaml"
    threads: threads_for("measure_traits")
    resources:
        **resources_for("measure_traits"),
    params:
        **stage_params("measure_traits", "geometry/interval_factors.yaml"),
    message:
        "{wildcards.tree}: measure the traits"
    script:
        "../../scripts/measure_traits.py"


rule compare_measures:
    input:
        # Who measured another tree reruns this one neither by the file's time nor by its rows.
        table=ancient(SETTINGS["measures"]) if BATCH.measured else [],
        traits="results/{tree}/traits.json",
        branches="results/{tree}/branches.csv",
        skeleton="results/{tree}/skeleton.graphml",
        scale=photo_only("results/{scan}/scale.json"),
        photo_check=photo_only("results/{tree}/photo_check.json"),
    output:
        measures=ensure("results/{tree}/measures.json", non_empty=True),
    log:
        "logs/compare_measures/{tree}.log",
    benchmark:
        "benchmarks/compare_measures/{tree}.tsv"
    conda:
        "../../envs/pointcloud.yaml"
    threads: 1
    resources:
        mem_mb=lambda wildcards, attempt: 1000 * attempt,
        runtime=10,
    params:
        code=code("compare_measures"),
        tree=row("tree"),
        rows=of_tree(BATCH.measures_of),
    message:
        "{wildcards.tree}: compare with hand measurements"
    script:
        "../../scripts/compare_measures.py"
