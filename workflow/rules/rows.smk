# Several trees in one scan, see docs/rows.md: which stand there, and a cloud of each.


ruleorder: split_scan > segment_cloud


checkpoint find_trees:
    input:
        segmented="results/{tree}/segmented.ply",
        limbs="results/{tree}/limbs.npz",
        metric=photo_only("results/{tree}/metric.json"),
    output:
        trees=ensure("results/{tree}/trees.json", non_empty=True),
        owners=ensure("results/{tree}/owners.npz", non_empty=True),
    log:
        "logs/find_trees/{tree}.log",
    benchmark:
        "benchmarks/find_trees/{tree}.tsv"
    wildcard_constraints:
        tree=any_of(BATCH.places),
    conda:
        "../../envs/pointcloud.yaml"
    threads: threads_for("find_trees")
    resources:
        **resources_for("find_trees"),
    params:
        **stage_params("find_trees"),
        scan=row("tree"),
    message:
        "{wildcards.tree}: find the trees of the scan"
    script:
        "../../scripts/find_trees.py"


rule split_scan:
    input:
        segmented=file_of("results/{scan}/segmented.ply"),
        grown=file_of("results/{scan}/limbs.npz"),
        trees=file_of("results/{scan}/trees.json"),
        owners=file_of("results/{scan}/owners.npz"),
        metric=photo_only("results/{scan}/metric.json"),
        shared=lambda wildcards: [
            file_of(f"results/{{scan}}/{name}")(wildcards)
            for name in ("scale.json", "align.json", "metric_poses.npz")
            if BATCH.row(wildcards.tree).is_photo_scan
        ],
    output:
        cloud=ensure("results/{tree}/segmented.ply", non_empty=True),
        limbs=ensure("results/{tree}/limbs.npz", non_empty=True),
        place=ensure("results/{tree}/tree.json", non_empty=True),
    log:
        "logs/split_scan/{tree}.log",
    benchmark:
        "benchmarks/split_scan/{tree}.tsv"
    wildcard_constraints:
        tree=rf"(?:{any_of(BATCH.places)})_[1-9][0-9]*",
    conda:
        "../../envs/pointcloud.yaml"
    threads: threads_for("split_scan")
    resources:
        **resources_for("split_scan"),
    params:
        code=code("split_scan"),
        tree=row("tree"),
    message:
        "{wildcards.tree}: take the tree out of its scan"
    script:
        "../../scripts/split_scan.py"
